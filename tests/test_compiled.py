import hashlib
import os
import subprocess
import sys

from rail_sumo import config_file
from rail_sumo.highway.compiled import compiled
from rail_sumo.rollout import Task, drive


def test_without_a_folder_for_its_cache_a_function_is_compiled_all_the_same():
    twice = eval("lambda number: 2.0 * number")  # it is in no file, so numba has nowhere to put its cache
    assert compiled("float64(float64)")(twice)(3.0) == 6.0


DRIVE = """
import hashlib
from rail_sumo import config_file
from rail_sumo.rollout import Task, drive
driven = drive(Task("rule", config_file.load(None, ["episode.duration_s=10.0"]), 5))
print(hashlib.sha256(driven.observations.tobytes() + driven.speed_mps.tobytes()).hexdigest())
"""


def test_an_episode_is_the_same_to_the_bit_whether_its_kernels_were_cached_or_not(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    printed = []
    for _ in range(2):  # compiled anew, then from the cache
        run = subprocess.run([sys.executable, "-c", DRIVE], env=environment, capture_output=True, text=True, check=True)
        printed.append(run.stdout)
    driven = drive(Task("rule", config_file.load(None, ["episode.duration_s=10.0"]), 5))
    here = hashlib.sha256(driven.observations.tobytes() + driven.speed_mps.tobytes()).hexdigest()
    assert printed == [f"{here}\n"] * 2
    assert list(tmp_path.rglob("*.nbi")), "numba kept nothing there: the test compared like with like"
