"""`servogym bench`."""

import argparse
import importlib
import json

from rich.console import Console

from . import arguments

# option -> module of `training.bench`; of several options, the first one here applies
MODULES = {
    "workers": "workers", "train": "train", "gpu": "device", "can": "can", "ethercat": "ethercat",
    "vectors": "vectors", "envs": "envs",
}
SWITCHES = {
    "can": "measure SDO servers and drives in lock-step",
    "envs": "measure the environments, compared with the loop and with other packages",
    "vectors": "compare our vector with those of other packages",
    "ethercat": "measure slave controllers, and pysoem on a veth pair",
    "train": "compare PPO on our vector and on DummyVecEnv",
}


def add(bench: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    bench.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    bench.add_argument(
        "--repeat", type=arguments.COUNT, help="number of pairs of blocks (200), or of runs (1)"
    )
    for name, text in SWITCHES.items():
        bench.add_argument(f"--{name}", action="store_true", help=text)
    bench.add_argument(
        "--gpu", nargs="?", const="cuda", metavar="DEVICE",
        help="measure machines on a warp device: cuda (the default), cuda:1, cpu",
    )
    bench.add_argument(
        "--workers", nargs="?", const=2, type=arguments.WORKERS, metavar="N",
        help="compare one process with N processes (2)",
    )
    bench.add_argument(
        "--compare", nargs=2, action="append", default=[], metavar=("ENV", "POLICIES"),
        help="with --workers: run this comparison instead of one for each learned task; repeatable",
    )
    bench.add_argument("--json", action="store_true", help="print JSON")
    bench.set_defaults(run=_bench)


def _bench(options: argparse.Namespace, console: Console) -> int:
    given = {name: getattr(options, name) for name in MODULES}
    asked = next((n for n, value in given.items() if value is not None and value is not False),
                 "drive")
    options.repeat = options.repeat or (1 if asked == "workers" else 200)
    module = importlib.import_module(f"..bench.{MODULES.get(asked, asked)}", __package__)
    with console.status("measuring ...") as status:
        results = module.results(options, status.update)
    if options.json:
        console.file.write(json.dumps(results, indent=1, default=float) + "\n")
    else:
        module.show(results, console)
    return 0
