"""Results as JSON, files, tables, pictures and reports. It shows; `lidarcfg.placement` computes."""

from lidarcfg.report.baseline import Baseline
from lidarcfg.report.beams import draw_sensor
from lidarcfg.report.comparison import (
    COMPARED,
    check_count,
    comparison_dict,
    contenders,
    save_comparison,
    with_baseline,
)
from lidarcfg.report.document import Commands
from lidarcfg.report.front import front_dict, load_front_logs, save_front, save_front_log
from lidarcfg.report.plots import COLOURS, draw_convergence, draw_rig, new_figure, save_figure
from lidarcfg.report.results import (
    EVALUATED,
    FRONT,
    RESULTS,
    baseline_dict,
    check_writable,
    evaluation_dict,
    load_log,
    placement_dict,
    save_evaluation,
    save_placement,
    save_progress,
    to_json,
)
from lidarcfg.report.sweep import SweepFolder
from lidarcfg.report.tables import (
    analytic_line,
    print_comparison,
    print_evaluation,
    print_front,
    print_placement,
    print_sensor,
    print_sensors,
)

__all__ = [
    "COLOURS",
    "COMPARED",
    "EVALUATED",
    "FRONT",
    "RESULTS",
    "Baseline",
    "Commands",
    "SweepFolder",
    "analytic_line",
    "baseline_dict",
    "check_count",
    "check_writable",
    "comparison_dict",
    "contenders",
    "draw_convergence",
    "draw_rig",
    "draw_sensor",
    "evaluation_dict",
    "front_dict",
    "load_front_logs",
    "load_log",
    "new_figure",
    "placement_dict",
    "print_comparison",
    "print_evaluation",
    "print_front",
    "print_placement",
    "print_sensor",
    "print_sensors",
    "save_comparison",
    "save_evaluation",
    "save_figure",
    "save_front",
    "save_front_log",
    "save_placement",
    "save_progress",
    "to_json",
    "with_baseline",
]
