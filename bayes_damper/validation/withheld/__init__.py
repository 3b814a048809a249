"""The check on data whose effect is withheld: freeze, diagnose, seal every verdict, only then open the key and score.

    from bayes_damper.validation.withheld import withheld
    found = withheld(folder, out="results/withheld")
    print(found.text())

`verify` holds the seals of a finished run's archive again.

sealing.py guards the key, scores.py turns verdicts and truths into figures, baselines.py holds simpler methods run on
the same campaigns, check.py runs it all, archive.py keeps it.
"""

from bayes_damper.validation.withheld.archive import Verified, verify
from bayes_damper.validation.withheld.check import Withheld, withheld

__all__ = ["Verified", "Withheld", "verify", "withheld"]
