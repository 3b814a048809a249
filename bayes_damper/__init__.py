"""bayes_damper: calibrate a magnetically coupled mass damper and find out why the model and the rig differ."""
