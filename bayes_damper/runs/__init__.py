"""Running and keeping long work: processes, checkpoints, progress, provenance, outcomes. Knows no mechanics."""
