"""What the package is held against: simulators that share no code with it. Not part of the wheel."""
