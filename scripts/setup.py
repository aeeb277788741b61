#!/usr/bin/env python3
"""Sets up what a build of CROSS needs beside cargo: SUMO, libtorch and the RESCO maps, under .deps/.

    python3 scripts/setup.py            install what is missing, say what is used
    python3 scripts/setup.py --check    only look; exit 1 if something is missing

Environment:
    CROSS_TORCH=cpu|cuda    which libtorch (cpu)
    CROSS_CACHE=DIR         keep the downloaded wheels there, so that another checkout need not fetch them
    LIBTORCH, SUMO_HOME     installations of your own; used where they fit

Python's standard library and pip are all it takes. Each part is unpacked beside its place and moved
there in one rename, so that an interrupted run leaves either the whole part or nothing of it.
"""

import os
import sys

# No byte code beside the sources: the set-up writes to .deps (and the cache) alone.
sys.dont_write_bytecode = True
if sys.version_info < (3, 9):
    sys.exit(
        "error: Python 3.9 or newer is needed, this is {}.{}; install a newer one and name it: "
        "make PYTHON=python3.12 build".format(*sys.version_info[:2])
    )

import argparse
from pathlib import Path

from deps import installed, machine, parts, wheels

CHECKOUT = Path(__file__).resolve().parent.parent


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--check", action="store_true", help="only look; exit 1 if something is missing")
    check_only = options.parse_args().check

    flavour = os.environ.get("CROSS_TORCH", "") or "cpu"
    if flavour not in ("cpu", "cuda"):
        print(f"error: CROSS_TORCH is {flavour!r}; set it to cpu or cuda", file=sys.stderr)
        return 2
    try:
        return set_up(CHECKOUT / ".deps", flavour, check_only)
    except (wheels.SetupError, machine.SetupError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: set-up could not write: {error}; free some space or fix the permissions, then run it again", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nset-up interrupted; run it again to go on where it stopped", file=sys.stderr)
        return 130


def set_up(deps, flavour, check_only):
    """Brings `deps` up to date; returns the exit code."""
    own = [installed.libtorch(os.environ, flavour), installed.sumo(os.environ)]
    for found in own:
        if found.remark:
            print(f"set-up: {found.remark}")
    if installed.astray(os.environ):
        print(f"set-up: not used: {', '.join(installed.astray(os.environ))}; LIBTORCH alone names a libtorch of your own")
    provided = {found.part for found in own if found.fits}
    wanted = [part for part in parts.all_parts(flavour) if part.name not in provided]
    missing = [part for part in wanted if not part.is_installed(deps)]

    machine.check_tools(CHECKOUT / "Cargo.toml")
    if missing and check_only:
        print("set-up: missing: " + ", ".join(part.label for part in missing) + "; run make build")
        return 1
    if missing:
        machine.check_for_install(deps, missing)
        with wheels.exclusive(deps):
            for part in missing:
                # Another run may have held the lock and done it.
                if not part.is_installed(deps):
                    part.install(deps, wheels.Store.for_environment(deps, os.environ))
    if not check_only:
        installed.write_environment(deps, own)

    labels = [found.label for found in own if found.fits] + [part.label for part in reversed(wanted)]
    print(f"set-up: {'done' if missing else 'nothing to do'} ({', '.join(labels)})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
