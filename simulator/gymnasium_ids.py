"""Register the environments' names in Gymnasium, without importing it: it is optional, and slow to load."""

from __future__ import annotations

import importlib.util
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final

MAX_STEPS: Final = 3000  # maximum steps of an episode: 300 s, enough for a lap of each track at 10 mph

_ENTRY_POINTS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "bc/Lake-v0": ("simulator.environment:DrivingEnv", {"track": "lake"}),
    "bc/Mountain-v0": ("simulator.environment:DrivingEnv", {"track": "mountain"}),
    "bc/Random-v0": ("simulator.environment:DrawnRoadEnv", {"kind": "random"}),
    "bc/Hairpins-v0": ("simulator.environment:DrawnRoadEnv", {"kind": "hairpins"}),
}


def register_environments() -> None:
    """Register the environments, now or, if Gymnasium has not been imported yet, when it is imported."""
    if sys.modules.get("gymnasium") is None:
        sys.meta_path.insert(0, _AfterGymnasium())
    else:
        _register()


def _register() -> None:
    from gymnasium.envs.registration import register, registry

    for name, (entry_point, settings) in _ENTRY_POINTS.items():
        if name not in registry:
            register(name, entry_point=entry_point, max_episode_steps=MAX_STEPS, kwargs=settings)


class _AfterGymnasium(MetaPathFinder):
    """Registers the environments at `import gymnasium`.

    `gymnasium.make("simulator:bc/Lake-v0")` imports this package to register its environments. If a program has
    imported the package before Gymnasium, Python does not import it again.
    """

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module: ModuleType) -> None:
                load(module)
                _register()

            spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec
