"""What `rail-sumo network check` tells before anybody drives."""

import pytest
from driving import world

from rail_sumo.errors import InputError
from rail_sumo.highway import trial


def test_the_check_tells_of_a_demand_that_never_comes_along_the_course(two_roads):
    assert trial.check(two_roads("beside"))[1] == []
    (told,) = trial.check(two_roads("highway"))[1]
    assert told.startswith(
        "when the host enters, no vehicle of the demand is on its course or on the way to it; lead netw"
    )


def test_the_check_tries_the_demand(tmp_path):
    lost = tmp_path / "lost.rou.xml"
    lost.write_text('<routes><vehicle id="v" depart="0"><route edges="nowhere"/></vehicle></routes>')
    with pytest.raises(InputError, match=r"SUMO .*nowhere"):
        trial.check(world(traffic={"routes": (str(lost),)}))


def test_a_check_that_fails_leaves_no_simulation_open(tmp_path):
    late = tmp_path / "late.rou.xml"
    late.write_text('<routes><vehicle id="v" depart="500"><route edges="highway"/></vehicle></routes>')
    for _ in range(2):
        with pytest.raises(InputError, match="no vehicle of the demand is on the road at 60 s"):
            trial.check(world(traffic={"routes": (str(late),)}))


def test_the_check_tells_of_a_demand_out_of_order(tmp_path):
    path = tmp_path / "late.rou.xml"
    vehicles = "".join(f'<vehicle id="v{at}" depart="{at}"><route edges="highway"/></vehicle>' for at in (0, 50, 40))
    path.write_text(f"<routes>{vehicles}</routes>")
    (told,) = trial.check(world(traffic={"routes": (str(path),)}))[1]
    assert "is not in order of departure: 'v40' may enter late" in told
