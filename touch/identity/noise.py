"""How likely contacts are at a pose of an object, whatever their noise: points, normals and false ones.

A contact is off the surface by exponential noise of one scale, its normal turned from the surface's by von Mises and
Fisher's distribution of one concentration; or it is false, anywhere within reach, its normal any. Some normals of true
contacts mean nothing either; and all may point into the object, by another convention. None of these sizes is known:
each is summed over, with what is believed of it. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.identity.noise_kernels import log_likelihoods

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContactNoiseSettings:
    """What is believed of contacts. Values by judgement where no source is named."""

    # Scale of the noise (m): no mesh is truer than the first, no finger worse than the second. How many between them
    # are summed over: neighbours differ by 1.45, which a few contacts cannot tell.
    least: float = 0.5e-3
    largest: float = 0.015
    scales: int = 10
    # Standard deviation of the logarithm of the true scale over the one that sigmas tell, as `touch.posterior` has it;
    # the usual sigma (m) where none is told, and its spread; and the share of beliefs of neither: any, by factor.
    told_spread: float = 0.4
    usual: float = 1.2e-3
    untold_spread: float = 0.8
    any_scale: float = 0.1
    # Shares of false contacts that are thought possible, and how far off the surface one lies at most (m).
    false_shares: tuple[float, ...] = (0.02, 0.1, 0.25, 0.45)
    false_beliefs: tuple[float, ...] = (8.0, 4.0, 2.0, 1.0)
    false_reach: float = 0.1
    # How far normals are turned (rad: 5, 11 and 25 degrees), whatever sigma they are told with: fingers press edges,
    # and drivers write constants. Shares of them that mean nothing, and how likely all point inward.
    turned: tuple[float, ...] = (0.09, 0.19, 0.44)
    meaningless: tuple[float, ...] = (0.05, 0.25)
    inward: float = 0.05


class Noise:
    """Beliefs of the noise of some contacts, and their likelihood summed over these."""

    def __init__(self, contacts: Contacts, power: float, settings: ContactNoiseSettings | None = None) -> None:
        """power: to which the likelihood is taken, 1 where each contact errs on its own."""
        s = settings or ContactNoiseSettings()
        self.contacts, self.power, self.settings = contacts, power, s
        self.scales = np.geomspace(s.least, s.largest, s.scales)
        # the mean of the size of a Gaussian is 0.8 of its sigma
        told = float(np.sqrt(np.mean(contacts.sigma_point**2))) if contacts.sigma_known else s.usual
        spread = s.told_spread if contacts.sigma_known else s.untold_spread
        middle = np.log(np.clip(0.8 * told, s.least, s.largest))
        near = np.exp(-0.5 * ((np.log(self.scales) - middle) / spread) ** 2)
        believed = (1.0 - s.any_scale) * near / near.sum() + s.any_scale / s.scales
        self.known = np.ascontiguousarray(contacts.has_normal)
        self.normals, beliefs = np.array([[1.0, 1.0, 1.0]]), np.ones(1)
        if self.known.any():
            signs = ((1.0, 1.0 - s.inward), (-1.0, s.inward))
            grid = [(t**-2, m, sign, share) for t in s.turned for m in s.meaningless for sign, share in signs]
            self.normals, beliefs = np.array(grid)[:, :3], np.array(grid)[:, 3]
        self.worths = np.array([(share, 1.0 / s.false_reach) for share in s.false_shares])
        shares = believed[:, None, None] * np.array(s.false_beliefs)[:, None] * beliefs
        self._beliefs = np.log(np.maximum(shares / shares.sum(), 1e-300))

    def at(self, model: ObjectModel, poses: Array, met: NDArray[np.int64] | None = None) -> Array:
        """(n,) log likelihood of the contacts at poses (n, 4, 4) contacts_frame_from_object. met (n,): a contact that
        was laid on the surface.
        """
        turned = poses[:, :3, :3]
        shift = np.einsum("pkj,pk->pj", turned, poses[:, :3, 3])
        local = np.ascontiguousarray((self.contacts.points @ turned - shift[:, None]).reshape(-1, 3))
        distance, gradient = model.field.distance_and_gradient(local)
        along = np.zeros((len(poses), len(self.known)))
        if self.known.any():
            outward = model.field.normals(local - distance[:, None] * gradient).reshape(*along.shape, 3)
            felt = np.where(self.known[:, None], self.contacts.normals, 0.0) @ turned
            along = np.sum(outward * felt, axis=2)
        away = np.abs(distance).reshape(along.shape)
        if met is not None:
            away[np.arange(len(poses)), met] = -1.0
        return self.of(away, along)

    def of(self, distances: Array, along: Array) -> Array:
        """(n,) log likelihood, from distances (n, contacts) and cosines (n, contacts) of normals with the surface's."""
        out = np.zeros(len(distances))
        grid = self.scales, self.normals, self.worths, self._beliefs
        log_likelihoods(distances, along, self.known, *grid, float(self.power), out)
        return out
