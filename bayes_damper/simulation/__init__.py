"""From parameters to records: the integrator's step, effects composed into it, compiled code, the model."""
