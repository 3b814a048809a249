"""Laboratories: campaigns of many rigs, designs, noises and scatters, made by a simulator of its own.

It shares no code and no formula of a disturbance with the package; common are the nominal equations, which is what
"nominal" means. README.md beside this file has the draws.
"""
