"""From touch to contact evidence, and every estimator that works on touch alone."""

from scenes.frames import Contacts
from touch.localize import Localization, localize
from touch.recognition import Identification, identify

__all__ = ["Contacts", "Identification", "Localization", "identify", "localize"]
