"""What a rig must see, and the verdict: does it?

The way of a verdict, by the functions that run:

    file.entries_of           reads requirements, each of the kind in `KINDS` whose key it has
    resolved.resolved         by each `Kind.resolve`: a `Requirement` of the study, of objects read, and zones in metres
    Requirements.judges       by each `Requirement.judge_with`: its `Judge`
    verify.Verifier.verify    asks each judge in turn: PASS if all pass
    ObjectJudge.judge         measures what is reached at places of a grid, around the lowest, and with mounting errors;
                              `RequirementVerdict.passed` if that is no less in the worst than the `returns` demanded
    Verifier.verification     by each `Judge.evidence`: what shows it, a map, the worst place, margins

A search asks the same judges, by `shortfalls`: `Judge.bounds` says soon that a rig is no better than another.

To read in this order: `kind` is the protocol of a kind of requirement, `judge` that of a requirement and its judge.
`object`, `post`, `shadow`, `price` and `sensor_count` are a kind each, `scenarios` a folder with one; the judge of an
object is in `object_judge`. `file` reads requirements and has the table of kinds, `resolved` has those of a study.
`verify` judges a rig by all of them, `verdict` is the result, with a scenario's `speeds`, and `evidence` what shows it.
`shortfalls` judges many rigs, for searches. Kinds share `robustness`, the failures and mounting errors that a rig must
withstand, and `allowed_rigs`, what all rigs of a study can reach. What is reached at places is counted in
`lidarcfg.returns`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
