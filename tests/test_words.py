"""The words of the field are used in code, keys, help and documentation alike."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXTS = sorted(
    path
    for pattern in (
        "lidarcfg/**/*",
        "docs/**/*.md",
        "docs/examples/*",
        "sensors/*",
        "data/**/*.yaml",
        "tools/*",
        "README.md",
    )
    for path in ROOT.glob(pattern)
    if path.suffix in (".py", ".pyi", ".js", ".html", ".css", ".md", ".yaml", ".sh", "")
    and path.is_file()
    and "vendor" not in path.parts
)
# What is not said, as whole words; what is said instead; a sentence that is found.
BANNED = {
    r"(rays?|beams?|lasers?) (that )?(meets?|met|meeting)|(meets?|met) (something|nothing|an? |the (ground|wall|object))": (
        "hit",
        "what a beam meets",
    ),
    r"stands? still|movers?": ("static and dynamic objects", "a mover"),
    r"sectors?": ("horizontal field of view", "a narrow sector"),
    r"balls?": ("bounding sphere", "the ball around an object"),
    r"hairs?|rim (of|for) rounding": ("tolerance, epsilon", "larger by a hair"),
    r"(the|this|what|a|their) share|shares? of (the|all|its|a)|share =": (
        "fraction",
        "the share of the beam",
    ),
    r"(left|leaves?|leaving) out": ("excluded, omitted", "cuboids left out"),
    r"middle of the bounds": ("midpoint of the bounds", "the middle of the bounds"),
    r"judge|judges|judged|judging": ("evaluate, score", "all rigs are judged"),
    r"on_note|notes? (on|that|about)|note: str": ("warning", "a note on what was assumed"),
    r"doubles? (is|are|were|dropped|left)": ("duplicate", "doubles are dropped"),
    r"way: Trajectory|way = Trajectory|the vehicle's way": ("trajectory", "the vehicle's way"),
    r"hears?|heard|hearing": ("see", "what a LiDAR hears"),
    r"lest": ("so that … not", "lest it touches"),
}
ALLOWED = {  # the place, and what stands there
    ("docs/scene.md", "ball"),  # an object that is one
    ("data/scenes/street.yaml", "ball"),
}


def found(pattern, text):
    return re.finditer(rf"(?<![\w-])(?:{pattern})(?!\w)", text, re.IGNORECASE)


def test_there_is_something_to_read():
    assert len(TEXTS) > 250
    assert {path.suffix for path in TEXTS} >= {".py", ".md", ".yaml", ".js", ".html"}


@pytest.mark.parametrize(("pattern", "instead", "example"), [(key, *value) for key, value in BANNED.items()])
def test_words(pattern, instead, example):
    assert list(found(pattern, example)), "it would not be found"
    said = [
        f"{place}:{text.count(chr(10), 0, match.start()) + 1}: {match[0]!r}; say {instead}"
        for path in TEXTS
        for text in [path.read_text()]
        for place in [path.relative_to(ROOT).as_posix()]
        for match in found(pattern, text)
        if (place, match[0]) not in ALLOWED
    ]
    assert said == []
