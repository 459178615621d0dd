"""A search's result and a rig's evaluation on the terminal, by the tables of reports."""

from lidarcfg.report.blind_spots import volumes_table
from lidarcfg.report.describe import has_cones
from lidarcfg.report.evaluation import detection_table, worst_table, zones_table
from lidarcfg.report.key_figures import figures_table, key_figures
from lidarcfg.report.misses import misses_lines, misses_table, rigs_seen
from lidarcfg.report.overview import rig_table
from lidarcfg.report.rig_report import search_facts
from lidarcfg.report.terminal import print_facts, print_table, terminal
from lidarcfg.report.verdict import print_verdict
from lidarcfg.search.run import Placement
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation
from lidarcfg.study.study import Study


def print_placement(study: Study, found: Placement, evaluation: Evaluation) -> None:
    """Print the evaluation of a search's rig, with what the search spent and found."""
    print_evaluation(study, found.rig, evaluation, found)
    for line in found.at_bounds:
        terminal().print(line)


def print_evaluation(study: Study, rig: Rig, found: Evaluation, placement: Placement | None = None) -> None:
    """Print the verdict, what is missed, the search, the rig, its figures and the worst subspaces."""
    console = terminal()
    if found.verdict:
        print_verdict(found.verdict)
    for line in placement.remarks if placement else ():
        console.print(line)
    if rigs := rigs_seen(study, rig, found, placement):
        table = misses_table(rigs)
        print_table(table)
        for line in (*misses_lines(study, rigs, placement), table.caption):
            console.print(line)
    if placement:
        print_facts(search_facts(study, placement))
    print_table(rig_table(study, rig, found).without("model"))
    midpoint_m = placement.midpoint_max_vsr_m if placement else None
    print_table(figures_table(key_figures(study, rig, found, None, midpoint_m)))
    detection = detection_table(study, found)
    tables = [
        zones_table(found.zones) if found.zones else None,
        detection and detection.without("what it is"),
        volumes_table(found.seen_by_m3) if study.visibility else None,
        worst_table(found).without("", "surface") if has_cones(rig) else None,
    ]
    for one in filter(None, tables):
        console.print(f"{one.caption}:")
        print_table(one)
