"""Contacts on edges, corners and the medial axis, deep inside, in one line, plane or place."""

from cases import contacts as stability_cases_contacts

CASES = stability_cases_contacts.CASES


def test_holds(case):
    case.run()
