"""The service's database: what an earlier release has stored in it."""

from estimates import DOUBT

from drapenet.service.database import DONE, Database


def test_warnings_that_were_stored_as_lines_are_records(tmp_path):
    database = Database(tmp_path)
    for name, found in (("old", "a pixel is large"), ("new", DOUBT.record)):
        database.add_estimate(name, name, "capture 1", about=(name, ""), state=DONE,
                              warnings=[found], estimate={"warnings": [found]})
    for name, record in (("old", {"text": "a pixel is large"}), ("new", DOUBT.record)):
        row = database.estimate(name)
        assert row["warnings"] == row["estimate"]["warnings"] == [record]
