"""`bayes-damper diagnose`: from a campaign's folder to diagnosis.json, the missing torque, and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayes_damper import figures
from bayes_damper.campaign import load_campaign
from bayes_damper.diagnosis import Diagnosis
from bayes_damper.diagnosis import diagnose as diagnose_campaign
from bayes_damper.effects import all_effects
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.priors import campaign_priors
from bayes_damper.provenance import provenance
from bayes_damper.run import write_json

NOMINALS = ("nonlinear", "linear")


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis and the folder that its files are in; `result` is what diagnosis.json holds."""

    folder: Path
    result: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    exit_code: ExitCode = ExitCode.DONE

    def to_json(self) -> dict[str, Any]:
        """What diagnosis.json holds."""
        return dict(self.result)

    def text(self) -> str:
        """The verdict in plain words, what speaks for it, and what to do next."""
        return "\n".join([*_words(self.result), *self.warnings, f"Files: {self.folder}"])


def diagnose(
    campaign: str | Path,
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    effects: str | Path | None = None,
    priors: str | Path | None = None,
    out: str | Path = "results/diagnose",
    seed: int = 1,
    threads: int = 2,
    tell: Callable[[str], None] = lambda _: None,
) -> Diagnosed:
    """Where the model and the rig differ, which unmodelled effect causes it, and how far adding it closes the gap.

    campaign : folder; nominal : "linear" leaves dry friction out, which then is a candidate; effects : folder with
    effects of your own; priors : prior file, by default priors.toml in the campaign; threads : simulations side by
    side.

    Raises
    ------
    InputError
        if the campaign, the priors or an effect cannot be used.
    """
    if nominal not in NOMINALS:
        raise InputError(f"--nominal {nominal}: expected one of {', '.join(NOMINALS)}")
    if str(campaign) == "thesis":
        raise InputError(
            "diagnose thesis: the thesis published no records, only 24 numbers, and a diagnosis from those is not "
            "built yet; `fit thesis` shows which of them the model cannot reach (predictive.svg)"
        )
    loaded = load_campaign(campaign)
    beside = Path(campaign) / "priors.toml"
    file = Path(priors) if priors is not None else beside if beside.exists() else None
    chosen = None if file is None else campaign_priors(file, loaded)
    found = diagnose_campaign(
        loaded, nominal=nominal, effects=all_effects(effects), priors=chosen, seed=seed, threads=threads, tell=tell
    )
    folder = Path(out)
    path = found.write(folder)
    result = found.to_json() | {"campaign_sha256": loaded.sha256, "provenance": provenance()}
    write_json(path, result)
    _draw(folder, found)
    return Diagnosed(folder, result, tuple(f"warning: {w}" for w in loaded.warnings))


def _words(result: Mapping[str, Any]) -> list[str]:
    probabilities = result["probabilities"]
    verdict = result["verdict"]
    share = probabilities[verdict]
    gap = result["gap"]
    if verdict == "none":
        lines = [f"No gap beyond the noise is shown (probability {share:.2f})."]
    elif verdict == "unknown":
        site = max(result["sites"], key=lambda s: result["sites"][s])
        told = (
            f"There is a gap that no effect of the library explains (probability {share:.2f}); it lies most likely at: "
        )
        lines = [told + f"{site}."]
    else:
        row = next(r for r in result["effects"] if r["name"] == verdict)
        lines = [f"The missing effect is {verdict} ({row['site']}), probability {share:.2f}: {row['formula']}."]
        lines += [
            f"  {name} = {p['mean']:.4g} {p['unit']}, 90 % interval {p['hdi90'][0]:.4g} to {p['hdi90'][1]:.4g}"
            for name, p in row["parameters"].items()
        ]
    if result.get("pair"):
        both, p = result["pair"]["effects"], result["pair"]["probability"]
        lines.append(f"One effect does not close the gap; {both[0]} and {both[1]} together do (probability {p:.2f}).")
    lines.append(
        f"Gap on held-out trials: {gap['answer']} (p = {gap['p_value']:.2g}); "
        f"residual {gap['nominal_rms']:.3g} before, {gap['augmented_rms']:.3g} after, noise {gap['noise_rms']:.3g}."
    )
    ranked = sorted(probabilities, key=lambda name: -probabilities[name])[:5]
    lines.append("Answers: " + ", ".join(f"{name} {probabilities[name]:.2f}" for name in ranked))
    sites = sorted(result["sites"], key=lambda s: -result["sites"][s])[:3]
    lines.append("Sites: " + ", ".join(f"{site} {result['sites'][site]:.2f}" for site in sites))
    if result["indistinguishable"]:
        lines.append(
            "Not to be told apart by these data: " + "; ".join(" / ".join(g) for g in result["indistinguishable"])
        )
    return lines + [f"note: {note}" for note in result.get("notes", [])]


def _draw(folder: Path, found: Diagnosis) -> None:
    probabilities = found.answers.probabilities
    figure = figures.ranking_figure(probabilities, found.sites, title=f"{found.campaign}: what is missing, and where")
    figures.save(figure, folder / "ranking")
    torques = found.site_map.torque
    if torques:
        strongest = max(torques, key=lambda found: float(np.abs(found.torque).max()))
        figures.save(
            figures.missing_torque_figure(strongest, title="torque that the nominal model lacks"),
            folder / "missing_torque",
        )
