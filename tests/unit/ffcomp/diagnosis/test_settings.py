"""Every number of the search has a unit, a meaning and an origin."""

from __future__ import annotations

from dataclasses import fields

from ffcomp.diagnosis.settings import SearchSettings


def test_every_setting_has_unit_meaning_and_origin() -> None:
    for each in fields(SearchSettings):
        assert all(each.metadata[key] for key in ("unit", "meaning", "origin")), each.name
