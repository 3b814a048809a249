"""The report: one self-contained HTML page from whatever results a folder holds."""

from bayes_damper.report.html import Report, report

__all__ = ["Report", "report"]
