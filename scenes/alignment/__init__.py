"""Poses against evidence: one robust, batched Levenberg-Marquardt for every stage of every sense."""

from scenes.alignment.batch import Alignment, AlignSettings, Prior, align, costs, terms

__all__ = ["AlignSettings", "Alignment", "Prior", "align", "costs", "terms"]
