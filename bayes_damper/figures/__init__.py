"""Every figure: numbers in, matplotlib figures out. The only folder that imports matplotlib and corner.

Figures are made for reports: readable in grey print and for colour-blind eyes (the palette of Okabe and Ito, with line
styles and markers that differ too), every axis with symbol and unit. Nothing is computed here but what drawing needs.
"""

from bayes_damper.figures import _matplotlib as _matplotlib

# isort: split
from bayes_damper.figures.diagnosis import gap_figure as gap_figure
from bayes_damper.figures.diagnosis import learnt_law_figure as learnt_law_figure
from bayes_damper.figures.diagnosis import missing_torque_figure as missing_torque_figure
from bayes_damper.figures.diagnosis import published_figure as published_figure
from bayes_damper.figures.diagnosis import ranking_figure as ranking_figure
from bayes_damper.figures.diagnosis import residual_maps_figure as residual_maps_figure
from bayes_damper.figures.posteriors import corner_figure as corner_figure
from bayes_damper.figures.posteriors import feature_check_figure as feature_check_figure
from bayes_damper.figures.posteriors import forest_figure as forest_figure
from bayes_damper.figures.posteriors import record_figure as record_figure
from bayes_damper.figures.posteriors import trace_figure as trace_figure
from bayes_damper.figures.studies import plan_figure as plan_figure
from bayes_damper.figures.studies import response_figure as response_figure
from bayes_damper.figures.studies import thesis_figure as thesis_figure
from bayes_damper.figures.studies import tuning_figure as tuning_figure
from bayes_damper.figures.studies import variability_figure as variability_figure
from bayes_damper.figures.studies import withheld_figure as withheld_figure
from bayes_damper.figures.studies import work_precision_figure as work_precision_figure
from bayes_damper.figures.style import COLOURS as COLOURS
from bayes_damper.figures.style import NOT_CONVERGED as NOT_CONVERGED
from bayes_damper.figures.style import STYLES as STYLES
from bayes_damper.figures.style import label as label
from bayes_damper.figures.style import mark as mark
from bayes_damper.figures.style import new_figure as new_figure
from bayes_damper.figures.style import raised as raised
from bayes_damper.figures.style import save as save
