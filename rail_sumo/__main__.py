"""`python -m rail_sumo` is `rail-sumo`."""

from rail_sumo.cli import main

if __name__ == "__main__":
    main()
