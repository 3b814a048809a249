"""Stands in for the diagnosis in tests of the withheld check: answers what a file in the campaign's folder says."""

import json
import os
import signal
from pathlib import Path

SITE = {"spring_cubic": "ground1", "sensor_gain": "sensor", "stick_slip": "interface", "none": "none"}


def answer(campaign, *, seed, leave_out, workers):
    """The probabilities of answer.json; what is left out of the library goes to `unknown`; each call is logged."""
    folder = Path(campaign)
    with (folder.parent.parent / "calls.log").open("a") as log:
        log.write(f"{folder.name} {seed} {','.join(leave_out)}\n")
    told = json.loads((folder / "answer.json").read_text())
    probabilities = {name: p for name, p in told.items() if name not in leave_out}
    probabilities["unknown"] = probabilities.get("unknown", 0.0) + 1.0 - sum(probabilities.values())
    verdict = max(probabilities, key=probabilities.get)
    ordered = sorted(probabilities, key=probabilities.get, reverse=True)
    sites = {}
    for name, p in probabilities.items():
        site = SITE.get(name, "ground1")
        sites[site] = sites.get(site, 0.0) + p
    return {
        "verdict": verdict,
        "probabilities": probabilities,
        "credible_set": ordered[: 1 + sum(sum(probabilities[n] for n in ordered[:k]) < 0.9 for k in (1, 2, 3))],
        "sites": sites,
        "pair": None,
        "gap": {"nominal_rms": 2.9, "augmented_rms": 2.01, "noise_rms": 2.0, "closed": {"median": 0.98}},
        "intervals90": {"mu": [0.0, 1.0], "k2t": [5.0, 6.0]},
        "seconds": float("nan"),
    }


def dies_once(campaign, *, seed, leave_out, workers):
    """Kills its own process, as the system does when memory runs out, the first time it sees the marked campaign."""
    marked = Path(campaign).parent.parent / f"{Path(campaign).name}.deadly"
    if marked.exists():
        marked.unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    return answer(campaign, seed=seed, leave_out=leave_out, workers=workers)


def stopped_once(campaign, *, seed, leave_out, workers):
    """Is stopped by Ctrl-C the first time it sees the marked campaign."""
    marked = Path(campaign).parent.parent / f"{Path(campaign).name}.deadly"
    if marked.exists():
        marked.unlink()
        raise KeyboardInterrupt
    return answer(campaign, seed=seed, leave_out=leave_out, workers=workers)


def fails(campaign, *, seed, leave_out, workers):
    """A diagnosis that cannot be made."""
    raise ZeroDivisionError("no such luck")
