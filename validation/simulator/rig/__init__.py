"""Independent simulator of the torsional rig with a magnetically coupled damper.

Written apart from the package it is used to test: nothing here imports it, and it imports nothing from here. Only the
nominal equations are common to both. `equations` integrates the motion, `sensors` turns motion into readings,
`kinds` lists what can be wrong with the rig, `gap` measures how much of it no nominal fit can hide, `campaign` draws
and writes the measured trials, `sets` makes many of them with one key.
"""
