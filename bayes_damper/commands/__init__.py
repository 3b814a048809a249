"""One module for each command that is not a subject of its own: the Python call behind `bayes-damper COMMAND`."""
