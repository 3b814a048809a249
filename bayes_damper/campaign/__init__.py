"""A campaign: the measured trials of one rig, read from a folder, checked, and written back.

`load_campaign` either returns a `Campaign` or raises `InputError` with every fault of every file at once. What can be
read but looks odd stands in `Campaign.warnings`. Nothing is repaired or dropped here: readings arrive as recorded.
"""

from __future__ import annotations

from bayes_damper.campaign.head import constant_from, head_from_table
from bayes_damper.campaign.loading import PLANNED_PERIODS, load_campaign, load_plan
from bayes_damper.campaign.structure import (
    COLUMNS,
    INPUT_COLUMNS,
    Campaign,
    Constant,
    Measurement,
    Rig,
    Trial,
    natural_period,
    noise_floor,
    record_columns,
    record_text,
)
from bayes_damper.campaign.writing import COMMENTS, campaign_toml, toml_value, trials_csv, write_campaign

__all__ = [
    "COLUMNS",
    "COMMENTS",
    "INPUT_COLUMNS",
    "PLANNED_PERIODS",
    "Campaign",
    "Constant",
    "Measurement",
    "Rig",
    "Trial",
    "campaign_toml",
    "constant_from",
    "head_from_table",
    "load_campaign",
    "load_plan",
    "natural_period",
    "noise_floor",
    "record_columns",
    "record_text",
    "toml_value",
    "trials_csv",
    "write_campaign",
]
