"""The released networks beside plain averages and LEAN, on the patches that their trainings held out.

    python docs/remake.py --measure cards --materials MATERIALS    measures, and makes the cards in models/weights
    python benchmarks/cards.py MATERIALS                           measures, and prints JSON

MATERIALS is the folder that the networks were trained on. What is measured is the validation of a training: one set of
14 is held out, and so are seeds of generated sets. Averages make the same models of the same patches, so a card cannot
hide where a network is behind them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from timing import CONFIGS, arguments, keep

from mipbake.models.registry import WeightsInfo, list_weights, load_network
from mipbake.training.config import TrainingConfig, read_config
from mipbake.training.data import load_materials
from mipbake.training.export import card
from mipbake.training.validation import Validator


def config_of(info: WeightsInfo) -> TrainingConfig:
    """The configuration that weights were trained with."""
    return read_config(CONFIGS / f"{info.name}.toml")


def measured(info: WeightsInfo, materials: Path) -> dict[str, Any]:
    """The hash of the weights, and their figures."""
    config = config_of(info)
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, folder=str(materials)))
    validator = Validator(load_materials(config)[1], config.network, config.loss.pixel_filter)
    return {"sha256": info.sha256, "figures": validator.score(load_network(info)).figures()}


def text(info: WeightsInfo, record: Mapping[str, Any], before: str) -> str:
    """A card, with the figures of a record where it has any of these weights.

    Args:
        before: the card that there is. What was added under headings of their own stays.
    """
    found = record.get(info.name)
    described = info.network.describe()
    assert described is not None, "a baseline is not released"
    parameters = sum(value.numel() for value in load_network(info).parameters())
    figures = found["figures"] if found and found["sha256"] == info.sha256 else {}
    _, heading, added = before.partition("\n## ")
    return card(info, described, config_of(info), parameters, figures) + heading + added


def main() -> None:
    options = arguments(__doc__, "materials", results=None)
    found = {}
    for info in list_weights():
        found[info.name] = measured(info, options.materials)
        print(info.name, flush=True)
    keep(found, options.results)


if __name__ == "__main__":
    main()
