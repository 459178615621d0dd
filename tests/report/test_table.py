"""The model of a table: one table worked by hand, on the terminal, on a page, as JSON and as CSV."""

import csv
import io
import json
import re
from html.parser import HTMLParser

import pytest
from jinja2 import Environment, PackageLoader

from lidarcfg.report.table import COUNT, PRICE, Cell, Column, Table, as_written, named, written
from lidarcfg.report.terminal import print_table

TABLE = Table(
    "Rigs by hand",
    [
        Column("rig", key="name"),
        Column("price", PRICE),
        Column("misses", ".2%"),
        Column("max VSR", ".3f", "m", "max_vsr_m"),
        Column("of child", ".2f", key=("detection", "child")),
        Column("sensors", COUNT),
        Column("verdict", key="pass"),
    ],
    [
        [named("front & <rear>"), 1234567.0, 0.01234, Cell(0.25, mark="best"), -0.001, 12, Cell(True, "PASS", mark="pass")],
        [Cell("b", "b!", link="points/b c/report.html"), 0.1 + 0.2, 0.5, 0.75, None, 1000, Cell(False, "FAIL", mark="fail")],
    ],
)  # fmt: skip
HEADS = ["rig", "price", "misses", "max VSR (m)", "of child", "sensors", "verdict"]
TEXTS = [
    ["front & <rear>", "1,234,567", "1.23%", "0.250", "0.00", "12", "PASS"],
    ["b!", "0.3", "50.00%", "0.750", "–", "1,000", "FAIL"],
]


class Cells(HTMLParser):
    """The words, the classes and the links of a page's cells, row by row."""

    def __init__(self, text):
        super().__init__()
        self.rows = []
        self.classes = []
        self.links = []
        self.inside = False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag == "tr":
            self.rows.append([])
            self.classes.append([])
        self.inside = self.inside or tag in ("th", "td")
        if tag in ("th", "td"):
            self.rows[-1].append("")
            self.classes[-1].append(dict(attributes).get("class", ""))
        if tag == "a":
            self.links.append(dict(attributes)["href"])

    def handle_endtag(self, tag):
        self.inside = self.inside and tag not in ("th", "td")

    def handle_data(self, data):
        if self.inside:
            self.rows[-1][-1] += data


def test_a_page_has_the_texts_the_alignment_the_marks_and_the_link():
    pages = Environment(loader=PackageLoader("lidarcfg.report"), autoescape=True)
    found = Cells(pages.from_string("{% from 'parts.html' import table %}{{ table(data) }}").render(data=TABLE))
    assert found.rows == [HEADS, *TEXTS]
    numbers = ["", "number", "number", "number", "number", "number", ""]
    assert found.classes[0] == numbers
    assert found.classes[1] == ["", "number", "number", "number best", "number", "number", "pass"]
    assert found.classes[2] == [*numbers[:-1], "fail"]
    assert found.links == ["points/b%20c/report.html"]


def test_the_terminal_has_the_same_texts(capsys):
    """In one table, as 110 columns hold it; a star is behind what is best, and numbers end where their heads end."""
    print_table(Table(TABLE.caption, TABLE.columns, [[*row[:3], row[3] and 0.25, *row[4:]] for row in TABLE.rows]))
    _, head, _, *rows = capsys.readouterr().out.splitlines()
    assert re.split("  +", head.strip()) == HEADS
    assert re.split("  +", rows[0].strip()) == TEXTS[0]
    assert re.split("  +", rows[1].strip()) == [*TEXTS[1][:3], "0.250", *TEXTS[1][4:]]
    assert {line[: head.index("price") + 5].rstrip()[-1] for line in (head, *rows[:2])} == {"e", "7", "3"}
    print_table(TABLE)
    said = capsys.readouterr().out
    assert all(text in said for row in TEXTS for text in row)
    assert said.count("0.250 *") == said.count(" *") == 1
    assert said.rstrip().endswith("* best of its row")


def test_json_has_the_values_by_their_keys():
    assert json.loads(json.dumps(TABLE.records)) == [
        {
            "name": "front & <rear>",
            "price": 1234567.0,
            "misses": 0.01234,
            "max_vsr_m": 0.25,
            "detection": {"child": -0.001},
            "sensors": 12,
            "pass": True,
        },
        {
            "name": "b",
            "price": 0.1 + 0.2,
            "misses": 0.5,
            "max_vsr_m": 0.75,
            "detection": {"child": None},
            "sensors": 1000,
            "pass": False,
        },
    ]


def test_csv_has_the_values_to_twelve_figures():
    file = io.StringIO()
    TABLE.write_csv(file)
    head, *rows = csv.reader(io.StringIO(file.getvalue()))
    assert head == ["name", "price", "misses", "max_vsr_m", "detection.child", "sensors", "pass"]
    assert rows == [
        ["front & <rear>", "1234567", "0.01234", "0.25", "-0.001", "12", "True"],
        ["b", "0.3", "0.5", "0.75", "", "1000", "False"],
    ]


def test_a_long_name_is_short_where_it_is_shown_and_whole_in_files():
    table = Table("", [Column("name")], [[named("x" * 50, 10)]])
    assert table.texts == [["xxxxxx…xxx"]]
    assert table.records == [{"name": "x" * 50}]


def test_columns_are_left_out_and_a_wide_table_is_parted():
    assert [column.name for column in TABLE.without("price", "verdict").columns] == [
        "rig", "misses", "max VSR", "of child", "sensors",
    ]  # fmt: skip
    parts = TABLE.parts(4)
    assert [[column.name for column in part.columns] for part in parts] == [
        ["rig", "price", "misses", "max VSR", "of child"],
        ["rig", "sensors", "verdict"],
    ]
    assert parts[1].texts == [[row[0], *row[5:]] for row in TEXTS]


def test_numbers_are_rounded_as_they_are_written():
    """By hand: no value is -0, several stand with commas, what is not finite is no number."""
    assert written(-1e-9, "+.1%") == "+0.0%"
    assert as_written(0.12345, ".1%") == pytest.approx(0.123, abs=1e-15)
    assert as_written(1234.5678, ",.2f") == 1234.57
    column = Column("at", ".1f", "m")
    assert [column.cell(value).text for value in ((1.26, -0.01), float("nan"), float("inf"), "on cab", None)] == [
        "1.3, 0.0", "–", "–", "on cab", "–",
    ]  # fmt: skip
