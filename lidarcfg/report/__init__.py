"""Reports: results as JSON, tables, pictures and HTML pages. What the packages below compute, this one shows.

To read in this order: `inputs` computes what only a report needs, `text` shortens names, `describe` puts a study and a
rig into words, `table` is the model of all tables, which `terminal` prints and `page` puts on pages, and `evaluation`
has those of an evaluated rig. `key_figures` says what its main figures are called and which of several rigs has the
best. `canvas` has the style of drawings; `plots` (PNG), `mounts`, `drawings`, `blind_spots` draw a part each; `misses`
is what rigs miss, side by side. `rig_report` is the report of one rig, which begins with its `overview`, `comparison`
of several, `front` of price against objective, `cheapest` of the combinations searched for the cheapest rig; `repeat`
is their last section. `results` writes the folder of a search, `search_log` what it goes on from, `sweep` the folder of
many. A verdict is tables in `verdict`, `junit` for CI, and a page in `verification`, with drawings from `evidence` and
`scenario`. `printing` and `sensors` print on the terminal, `notebook` is what a notebook shows, and `summaries` says in
one line what a file is.

`__init__.pyi` lists the names. Each loads its module on first use, so a list of sensors loads no reports.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
