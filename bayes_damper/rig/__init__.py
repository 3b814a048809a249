"""The nominal rig: parameters, equations of motion, linear closed forms, vector maths. No effects, no data."""
