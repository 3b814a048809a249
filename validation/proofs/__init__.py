"""Programs for the pages of proofs by `bayes-damper withheld`: tables, runs scored as one, constants of the rule."""
