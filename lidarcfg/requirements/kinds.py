"""The kinds of requirements: a kind is a module, and a line here."""

from lidarcfg.requirements.kind import Kind
from lidarcfg.requirements.object import ObjectKind
from lidarcfg.requirements.post import PostKind
from lidarcfg.requirements.price import PriceKind
from lidarcfg.requirements.scenario import ScenarioKind
from lidarcfg.requirements.sensor_count import SensorCountKind
from lidarcfg.requirements.shadow import ShadowKind

KINDS: dict[str, type[Kind]] = {  # by the key that only they have
    ObjectKind.key: ObjectKind,
    PostKind.key: PostKind,
    ShadowKind.key: ShadowKind,
    ScenarioKind.key: ScenarioKind,
    PriceKind.key: PriceKind,
    SensorCountKind.key: SensorCountKind,
}
