"""The sim-to-real gap: whether there is one, what causes it, how far it shrinks."""
