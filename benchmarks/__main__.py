"""python -m benchmarks NAME [options]; the names are the modules of BENCHMARKS."""

import sys

from benchmarks import ambiguity, bounds, engines, mixtures, pareto, reading, robots, smoothing, vision, writing

BENCHMARKS = {
    "ambiguity": ambiguity,
    "bounds": bounds,
    "engines": engines,
    "mixtures": mixtures,
    "pareto": pareto,
    "reading": reading,
    "robots": robots,
    "smoothing": smoothing,
    "vision": vision,
    "writing": writing,
}


def main(arguments: list[str]) -> int:
    name, *options = arguments or ["--help"]
    if name not in BENCHMARKS:
        lines = [f"  {known}: {(module.__doc__ or '').splitlines()[0]}" for known, module in BENCHMARKS.items()]
        sys.stdout.write("\n".join(["python -m benchmarks NAME [--help]", *lines, ""]))
        return 0 if name in ("-h", "--help") else 2
    sys.stdout.write(BENCHMARKS[name].run(options) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
