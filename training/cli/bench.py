"""`servogym bench`."""

import argparse

from rich.console import Console


def add(bench: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    bench.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    bench.add_argument("--repeat", type=int, help="number of pairs of blocks (200), or of runs (1)")
    bench.add_argument(
        "--can", action="store_true", help="measure SDO servers and drives in lock-step"
    )
    bench.add_argument(
        "--envs", action="store_true",
        help="measure the environments, compared with the loop and with other packages",
    )
    bench.add_argument(
        "--vectors", action="store_true", help="compare our vector with those of other packages"
    )
    bench.add_argument(
        "--ethercat", action="store_true",
        help="measure slave controllers, and pysoem on a veth pair",
    )
    bench.add_argument(
        "--train", action="store_true", help="compare PPO on our vector and on DummyVecEnv"
    )
    bench.add_argument(
        "--gpu", nargs="?", const="cuda", metavar="DEVICE",
        help="measure machines on a warp device: cuda (the default), cuda:1, cpu",
    )
    bench.add_argument(
        "--workers", nargs="?", const=2, type=int, metavar="N",
        help="compare one process with N processes (2)",
    )
    bench.add_argument(
        "--compare", nargs=2, action="append", default=[], metavar=("ENV", "POLICIES"),
        help="with --workers: run this comparison instead of one for each learned task; repeatable",
    )
    bench.add_argument("--json", action="store_true", help="print JSON")
    bench.set_defaults(run=_bench)


def _bench(options: argparse.Namespace, console: Console) -> int:
    if options.repeat is not None and options.repeat < 1:
        raise ValueError(f"--repeat = {options.repeat} is out of range 1..")
    if options.workers is not None:
        from ..bench import workers as worker_bench
        from ..scale.work import Work

        Work(options.workers)
        return worker_bench.run(
            options.drive, options.workers, options.compare, options.repeat or 1, options.json,
            console,
        )
    options.repeat = options.repeat or 200
    if options.train:
        from ..bench import train as train_bench

        return train_bench.run(options.drive, options.json, console)
    if options.gpu:
        from ..bench import device as device_bench

        return device_bench.run(options.drive, options.gpu, options.json, console)
    if options.can:
        from ..bench import can as can_bench

        return can_bench.run(options.repeat, options.json, console)
    if options.ethercat:
        from ..bench import ethercat as ethercat_bench

        return ethercat_bench.run(options.repeat, options.json, console)
    if options.vectors:
        from ..bench import vectors as vector_bench

        return vector_bench.run(options.drive, options.repeat, options.json, console)
    if options.envs:
        from ..bench import envs as env_bench

        return env_bench.run(options.drive, options.repeat, options.json, console)
    from ..bench import drive as bench

    return bench.run(options.drive, options.repeat, options.json, console)
