"""From touch to contact evidence, and every estimator that works on touch alone."""

from scenes.frames import Contacts
from touch.localize import Localization, localize

__all__ = ["Contacts", "Localization", "localize"]
