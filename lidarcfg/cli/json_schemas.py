"""JSON Schemas of our files, made from the models that read them. Editors use them to complete keys and mark mistakes.

They do not express rules about several keys, such as that one of two is given; `lidarcfg validate` checks those.
"""

from importlib import import_module
from typing import Any

from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from lidarcfg.config.models import Model
from lidarcfg.packets.families import FAMILIES, family

KINDS = {  # module and model of each kind of file, loaded when they are needed
    "study": "lidarcfg.study.file:StudyFile",
    "requirements": "lidarcfg.requirements.file:RequirementsFile",
    "scenario": "lidarcfg.requirements.scenarios.file:ScenarioFile",
    "plan": "lidarcfg.search.sweep_plan:PlanFile",
    "rig": "lidarcfg.sensors.rig:RigFile",
    "scene": "lidarcfg.world.scene_file:SceneFile",
    "sensor": "lidarcfg.sensors.sensor:Sensor",
    "vehicle": "lidarcfg.world.vehicle:VehicleFile",
    "trajectory": "lidarcfg.world.motion:Motion",
    "faults": "lidarcfg.sensors.faults:FaultsFile",
}
DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _Untitled(GenerateJsonSchema):
    """Keys are their own titles."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def schema(kind: str) -> dict[str, Any]:
    """The JSON Schema (2020-12) of one of the `KINDS` of files."""
    models = {KINDS[kind]: _model(kind)}
    sections: dict[str, tuple[str, str, type[Model]]] = {}  # keys of a model that other models describe
    if kind == "rig":
        sections["vehicle"] = "RigFile", "vehicle", _model("vehicle")
    if kind in ("rig", "sensor"):
        for name in FAMILIES:
            codec = family(name)
            model = codec.settings_model if kind == "rig" else codec.facts_model
            sections[name] = ("MountFile" if kind == "rig" else "Sensor"), name, model
    wanted = [*models.values(), *(model for _, _, model in sections.values())]
    places, whole = models_json_schema([(model, "validation") for model in wanted], schema_generator=_Untitled)
    for owner, key, model in sections.values():
        part = whole["$defs"][owner]
        part["properties"][key] = places[model, "validation"]
        part["additionalProperties"] = False
    root = places[wanted[0], "validation"]
    return {"$schema": DIALECT, "title": f"lidarcfg {kind}", **root, **whole}


def _model(kind: str) -> type[Model]:
    module, _, name = KINDS[kind].partition(":")
    model: type[Model] = getattr(import_module(module), name)
    return model
