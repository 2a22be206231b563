"""The numbers of the search stand on a page as they are in the code."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from ffcomp.diagnosis.settings import SETTINGS, SearchSettings, settings_table

PAGE = Path(__file__).parents[4] / "docs" / "explanation" / "measuring_and_diagnosis.md"


def test_every_setting_has_unit_meaning_and_origin() -> None:
    for each in fields(SearchSettings):
        assert all(each.metadata[key] for key in ("unit", "meaning", "origin")), each.name


def test_the_page_has_the_table_of_the_code() -> None:
    assert settings_table(SETTINGS) in PAGE.read_text(encoding="utf-8")
