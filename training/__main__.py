"""`python -m mipbake.training [train] [CONFIG]` and `export CHECKPOINT NAME`."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path

from mipbake.base.errors import MipbakeError
from mipbake.base.extras import extra

CONFIGS = Path(__file__).parent / "configs"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m mipbake.training",
        description="Trains mipbake's networks. Without a command it trains: --steps 1000 is enough to type.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    train = commands.add_parser("train", help="train a network", description="Trains a network as a TOML file says.")
    train.add_argument(
        "config",
        nargs="?",
        metavar="CONFIG",
        help=f"TOML file, or one of {', '.join(sorted(path.stem for path in CONFIGS.glob('*.toml')))} (default: "
        "mipbake-1 with --data, else smoke, which makes sets of its own and no good network)",
    )
    train.add_argument("--steps", type=int, metavar="N", help="optimisation steps, in place of the configuration's")
    train.add_argument("--out", type=Path, metavar="DIR", help="checkpoints and logs (default: runs/<config's name>)")
    train.add_argument("--data", metavar="DIR", help="folder of texture sets, in place of the configuration's")
    train.add_argument("--resume", action="store_true", help="continue from the last checkpoint in --out")
    train.add_argument(
        "--start",
        type=Path,
        metavar="CHECKPOINT",
        help="weights to start from: of another training, or released ones (.safetensors)",
    )
    train.add_argument(
        "--device", default="cpu", metavar="DEVICE", help="cpu, or cuda for a graphics card (default: cpu)"
    )
    export = commands.add_parser(
        "export", help="release a checkpoint as weights", description="Writes NAME.safetensors, NAME.json and NAME.md."
    )
    export.add_argument("checkpoint", type=Path, metavar="CHECKPOINT", help="best.npz or last.npz of a training")
    export.add_argument("name", metavar="NAME", help="of the weights")
    export.add_argument("--out", type=Path, metavar="DIR", help="(default: where bakes look for weights)")
    export.add_argument("--default", action="store_true", help="use these weights where no others are named")
    given = sys.argv[1:]
    if not given or given[0] not in ("train", "export", "-h", "--help"):
        given = ["train", *given]
    return parser.parse_args(given)


def main() -> int:
    """Runs one command; returns the exit code."""
    arguments = _arguments()
    return exit_code(lambda: (_train if arguments.command == "train" else _export)(arguments))


def exit_code(command: Callable[[], object]) -> int:
    """The exit code of a command, with what went wrong in a sentence on stderr; 0 when nothing did."""
    try:
        with extra("train", "training"):
            command()
    except MipbakeError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted; a training goes on from its last checkpoint with --resume", file=sys.stderr)
        return 130
    return 0


def _train(arguments: argparse.Namespace) -> None:
    from mipbake.training.config import read_config

    named = arguments.config or ("mipbake-1" if arguments.data else "smoke")
    path, released = Path(named), CONFIGS / f"{named}.toml"
    if not path.exists() and released.exists():
        path = released
    config = read_config(path)
    if arguments.data:
        config = dataclasses.replace(config, data=dataclasses.replace(config.data, folder=arguments.data))
    if arguments.steps is not None:
        config = dataclasses.replace(config, run=dataclasses.replace(config.run, steps=arguments.steps))
    import torch

    from mipbake.base.allocator import keep_freed_memory
    from mipbake.training.loop import threads_beside_batches, train

    keep_freed_memory()
    torch.set_num_threads(threads_beside_batches())
    train(
        config,
        arguments.out or Path("runs") / path.stem,
        arguments.resume,
        start=arguments.start,
        device=arguments.device,
    )


def _export(arguments: argparse.Namespace) -> None:
    from mipbake.models.registry import WEIGHTS_FOLDER
    from mipbake.training.export import export_weights

    info = export_weights(arguments.checkpoint, arguments.name, arguments.out or WEIGHTS_FOLDER, arguments.default)
    print(f"{info.tensors}: {info.tensors.stat().st_size} bytes, SHA-256 {info.sha256}")


if __name__ == "__main__":
    sys.exit(main())
