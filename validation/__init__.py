"""What the package is held against: simulators that share no code with it, and programs for the pages of proofs.

Not part of the wheel.
"""
