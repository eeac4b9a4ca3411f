from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.unlocated import located_rows, unlocated_ns

S = 1_000_000_000


@pytest.mark.parametrize(
    ("t_s", "lost_s"),
    [([0, 1, 2, 3, 4], 0), ([0, 1, 3, 4], 2), ([2, 3, 4], 2), ([0, 1], 3), ([], 4), ([-5, 1, 2, 3, 9], 0)],
)
def test_gaps_of_more_than_a_second_count_also_at_both_ends(t_s, lost_s):
    assert unlocated_ns(np.array(t_s, dtype=np.int64) * S, 0, 4 * S) == lost_s * S
    t_ns = np.arange(0, 4 * S, S // 2)
    assert (t_ns[located_rows(t_ns, np.isin(t_ns, [S, 3 * S]))] / S).tolist() == [1, 1.5, 2, 3, 3.5]
