"""A verdict as JUnit XML, which CI servers read."""

from collections.abc import Iterator, Mapping
from xml.sax.saxutils import escape, quoteattr

from lidarcfg.report.verdict import quantity, worst_place
from lidarcfg.requirements.speeds import SpeedVerdict, SpeedVerdicts
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict


def junit(found: Verdict, name: str) -> str:
    """The verdict as JUnit XML: a test case for each requirement, of a scenario for each of its speeds instead."""
    cases = [case for one in found.requirements for case in _cases(one)]
    up_to = {f"{one.name}: in_time_up_to_km_h": _up_to(one.speeds) for one in found.requirements if one.speeds}
    failed = sum(len(one.speeds.failed) if one.speeds else not one.passed for one in found.requirements)
    counts = f'tests="{len(cases)}" failures="{failed}" errors="0" skipped="0"'
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        "<testsuites>",
        f"  <testsuite name={_quoted(name)} {counts}>",
        *_properties(up_to, "    "),
        *cases,
        "  </testsuite>",
        "</testsuites>",
        "",
    ]
    return "\n".join(lines)


def _cases(one: RequirementVerdict) -> Iterator[str]:
    more = [f"fails without any one of {', '.join(one.breaking)}" if one.passed and one.breaking else ""]
    more += [*one.notes, one.sampling.text if one.sampling else "", one.not_achievable or ""]
    if one.speeds:
        for at in one.speeds.tested:
            name = f"{one.name} at {at.speed_km_h:g} km/h"
            yield _case(name, at.passed, _said(at), [one.speeds.text, _lost(at.lost), *more], _figures(at))
        return
    said = f"demanded {'at most' if one.at_most else 'at least'} {quantity(one.demanded, one.unit)}"
    said += f", reached {quantity(one.reached, one.unit)}"
    yield _case(one.name, one.passed, said, [worst_place(one), _lost(one.lost), *more])


def _case(name: str, passed: bool, said: str, more: list[str], figures: Mapping[str, str] | None = None) -> str:
    text = escape(xml_text("\n".join(filter(None, [said, *more]))))
    if passed:
        outcome = f"      <system-out>{text}</system-out>"
    else:
        outcome = f'      <failure message={_quoted(said)} type="requirement">{text}</failure>'
    begin = f'    <testcase classname="requirements" name={_quoted(name)}>'
    return "\n".join([begin, *_properties(figures or {}, "      "), outcome, "    </testcase>"])


def _said(at: SpeedVerdict) -> str:
    """Why it is too late at a speed, or what was seen, and the margin."""
    seen = "" if at.seen_m is None else f"seen {at.seen_m:.1f} m before the impact"
    margin = f"{at.needed_m:.1f} m needed, margin {at.margin_m:+.1f} m, {at.margin_s:+.2f} s"
    return ", ".join(filter(None, [at.why, seen, margin]))


def _figures(at: SpeedVerdict) -> dict[str, str]:
    """The figures of a speed that differ from run to run."""
    values = {"seen_m": at.seen_m, "needed_m": at.needed_m, "margin_m": at.margin_m, "margin_s": at.margin_s}
    return {key: f"{value:.3f}" for key, value in values.items() if value is not None}


def _up_to(speeds: SpeedVerdicts) -> str:
    return "none" if speeds.up_to_km_h is None else f"{speeds.up_to_km_h:g}"


def _lost(names: tuple[str, ...]) -> str:
    return f"sensors lost there: {', '.join(names)}" if names else ""


def _properties(values: Mapping[str, str], indent: str) -> list[str]:
    """The lines of properties; none without values."""
    lines = [f"{indent}  <property name={_quoted(key)} value={_quoted(value)}/>" for key, value in values.items()]
    return [f"{indent}<properties>", *lines, f"{indent}</properties>"] if lines else []


def _quoted(text: str) -> str:
    """A text as an attribute's value."""
    return quoteattr(xml_text(text))


def xml_text(text: str) -> str:
    """A text without the characters that XML 1.0 cannot hold."""
    return "".join(
        c if c in "\t\n\r" or " " <= c <= "\ud7ff" or "\ue000" <= c <= "\ufffd" or c > "\uffff" else "\ufffd"
        for c in text
    )
