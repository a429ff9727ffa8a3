from rail_sumo.highway.compiled import compiled


def test_without_a_folder_for_its_cache_a_function_is_compiled_all_the_same():
    twice = eval("lambda number: 2.0 * number")  # it is in no file, so numba has nowhere to put its cache
    assert compiled("float64(float64)")(twice)(3.0) == 6.0
