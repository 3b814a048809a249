"""Published features of a rig (peaks, periods, decrements): measurements, how the model makes them, their posterior."""
