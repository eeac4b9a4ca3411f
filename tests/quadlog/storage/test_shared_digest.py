from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.storage import shared_digest
from quadlog.storage.byte_ranges import LocalBytes
from quadlog.storage.shared_digest import SharedDigest

stretches = st.lists(st.tuples(st.integers(0, 5000), st.integers(0, 2000)), max_size=30)


@given(size=st.integers(0, 5000), read=stretches, in_order=st.booleans(), gap=st.sampled_from([0, 100, 10_000]))
def test_whatever_is_read_the_digest_is_that_of_the_file(size, read, in_order, gap, tmp_path_factory):
    content = bytes(index * 7 % 251 for index in range(size))
    path = tmp_path_factory.mktemp("file") / "f"
    path.write_bytes(content)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shared_digest, "GAP_BYTES", gap)
        file = LocalBytes(path)
        digest = SharedDigest(file)
        with ThreadPoolExecutor(3) as threads:
            list(threads.map(lambda each: file.read(*each), sorted(read) if in_order else read))
        assert digest.finish() == hashlib.sha256(content).hexdigest()
        file.close()
