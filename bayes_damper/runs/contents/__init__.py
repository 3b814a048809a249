"""What files of results hold, one module for each kind: made where it is computed, read by all that shows it.

JSON is parsed once, at `json_files`; keys that older files lack are read with `get`.
"""
