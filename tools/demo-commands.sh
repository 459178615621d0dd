# Sourced by tools/demo, and by whoever tries an installed package: the demo's commands.
# Usage: source tools/demo-commands.sh BIN OUT   (the folder of lidarcfg and python; where the results go)
bin=$1
out=$2
study=data/studies/sedan.yaml
scene=data/scenes/street.yaml

rm -rf "$out"
mkdir -p "$out"
say "1/4 placing four VLP-16 on a saloon whose body blocks their beams, so that they miss least of what is around it"
"$bin/lidarcfg" optimize "$study" -o "$out" --seconds 20 >"$out/optimize.txt"
say "2/4 one second of what they send, the body with them, standing in $scene"
"$bin/lidarcfg" export "$out/rig.yaml" --scene "$scene" --at=0,-1.8,0 --duration 1 -o "$out/capture.pcap"
say "3/4 decoding it and merging the clouds by the rig's poses"
"$bin/lidarcfg" decode "$out/capture.pcap" --rig "$out/rig.yaml" -o "$out/cloud.ply"
say "4/4 a picture, and a page to walk through"
"$bin/lidarcfg" view "$out/cloud.ply" "$out/rig.yaml" --png "$out/picture.png"
"$bin/lidarcfg" view "$out/cloud.ply" "$out/rig.yaml" "$study" --html "$out/page.html"
"$bin/python" - "$out" <<'PYTHON'
import json
import sys
from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from lidarcfg.capture.pcap import read_datagrams
from lidarcfg.clouds.cloud import load_cloud

out = Path(sys.argv[1])
result = json.loads((out / "result.json").read_text())
console = Console(highlight=False, width=100)
found, told = result["misses"], result["believed"]
rigs = {"this rig": found, "best plain rig": told["best_plain"]["misses"], "middle of the bounds": told["midpoint"]["misses"]}
missed = Table("misses", *(Column(title, justify="right") for title in rigs), box=SIMPLE)
for number, one in enumerate(found["objects"]):
    missed.add_row(one["name"], *(f"{rig['objects'][number]['share']:.2%}" for rig in rigs.values()))
missed.add_row("mean", *(f"{rig['share']:.2%}" for rig in rigs.values()), style="bold")
console.print(missed)
console.print(f"misses: places within 20 m where an object gets fewer than {found['returns']} returns in a revolution")
table = Table(box=SIMPLE, show_header=False)
table.add_row("evaluations", f"{result['evaluations']:,}")
table.add_row("seconds", f"{result['seconds']:.1f}")
table.add_row("packets", f"{sum(1 for _ in read_datagrams(out / 'capture.pcap', print)):,}")
table.add_row("points", f"{len(load_cloud(out / 'cloud.ply', print).xyz):,}")
for what, name in (
    ("report", "report.html"),
    ("rig", "rig.yaml"),
    ("result, convergence", "result.json convergence.png rig.png"),
    ("capture", "capture.pcap"),
    ("merged cloud", "cloud.ply"),
    ("picture, page", "picture.png page.html"),
):
    table.add_row(what, " ".join(str(out / part) for part in name.split()))
console.print(table)
PYTHON
