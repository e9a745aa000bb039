"""Rotations at and near 0 and pi, a million composed steps, 10 km from the origin."""

from cases import poses as stability_cases_poses

CASES = stability_cases_poses.CASES


def test_holds(case):
    case.run()
