"""The sim-to-real gap: whether there is one, what causes it, how far it shrinks.

    from bayes_damper.diagnosis import diagnose
    diagnosis = diagnose(load_campaign(folder))
    diagnosis.verdict, diagnosis.answers.probabilities
    diagnosis.write(out)

search.py screens and fits the effects, remainder.py tests what they leave, verdict.py turns both into probabilities,
pipeline.py runs them in order.
"""

from bayes_damper.diagnosis.pipeline import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
