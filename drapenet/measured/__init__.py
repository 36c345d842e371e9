"""Kinds of measurements of a fabric: how each is read, shown, recorded and joined with others.

A further kind is a folder here with a class of :class:`drapenet.measured.base.Measured`, and a line
in :data:`KINDS`.
"""

KINDS = {
    "capture.yaml": "drapenet.measured.captures:Captured",
    "density.txt": "drapenet.measured.captures:Captured",
    "values.yaml": "drapenet.measured.values:ValueSet",
    "tension.yaml": "drapenet.measured.tension.folder:TensionSet",
    "strips.yaml": "drapenet.measured.strips.folder:StripSet",
}
"""Module and class of each kind by the file that describes its sources, in the order in which they
count; texts, as a photograph need not import the simulator of strips."""
VALUES = "values.yaml"
"""The description of values alone."""
SCAN = "drapenet.measured.captures:Scan"
"""The kind that has no description beside its file."""
