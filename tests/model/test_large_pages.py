"""Arrays in large pages: what they hold is theirs, whatever becomes of the memory's owner."""

import copy
import gc
import pickle

import numpy as np
import pytest
import torch

from corporeal.model.large_pages import large_page_array


@pytest.mark.parametrize(
    ("shape", "dtype"), [((3, 5), np.float32), ((700, 1000), np.float64), ((0, 4), float)]
)
def test_an_array_has_its_shape_and_can_be_written(shape, dtype):
    array = large_page_array(shape, dtype)
    assert (
        array.shape == shape and array.dtype == dtype and array.flags.writeable and array.flags.c_contiguous
    )
    array[:] = 7
    assert (array == 7).all()


def test_a_large_one_begins_at_a_large_page_and_outlives_its_makers_names():
    array = large_page_array((1 << 19, 2), np.float32)
    assert array.ctypes.data % (1 << 21) == 0
    array[:] = np.arange(len(array))[:, None]
    tensor = torch.from_numpy(array)
    copies = copy.deepcopy(tensor), pickle.loads(pickle.dumps(tensor))
    del array
    gc.collect()
    for values in (tensor, *copies):
        assert values[:, 1].sum(dtype=torch.float64) == sum(range(1 << 19))
