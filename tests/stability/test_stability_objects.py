"""Sizes from 5 mm to 2 m, defects of meshes, borders of the lattice."""

from cases import objects as stability_cases_objects

CASES = stability_cases_objects.CASES


def test_holds(case):
    case.run()
