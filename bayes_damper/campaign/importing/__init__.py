"""From logger files to a campaign folder: `importer` is the door, the other files are its parts.

`options` has the keys of an import table, `table` makes one from the options of `init` and `guesses` what they leave
out; `logger_*` read files, `clocks` and `units` turn their columns into times and readings in SI units.
"""
