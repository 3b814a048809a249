"""The sim-to-real gap: whether there is one, what causes it, how far it shrinks.

    from bayes_damper.diagnosis import diagnose
    diagnosis = diagnose(load_campaign(folder))
    diagnosis.verdict, diagnosis.answers.probabilities
    diagnosis.to_json()

search.py screens and fits the effects, remainder.py tests what they leave, verdict.py turns both into probabilities,
judgement.py turns both into answers, pipeline.py runs them in order; result.py holds what comes out.
"""

from bayes_damper.diagnosis.pipeline import diagnose
from bayes_damper.diagnosis.result import Diagnosis

__all__ = ["Diagnosis", "diagnose"]
