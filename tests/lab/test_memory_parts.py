"""Resident memory by part."""

from linemate.simulators.lab.bench import memory_parts
from linemate.simulators.lab.bench.memory_parts import ANONYMOUS, OTHERS

SMAPS = """\
1000-2000 r-xp 00000000 08:01 7 /x/numpy.libs/libscipy_openblas64_.so
Size:               9999 kB
Rss:                2048 kB
2000-3000 rw-p 00000000 08:01 7 /x/numpy.libs/libscipy_openblas64_.so
Rss:                1024 kB
3000-4000 rw-p 00000000 00:00 0                          [heap]
Rss:                5120 kB
4000-5000 rw-p 00000000 00:00 0
Rss:                1024 kB
5000-6000 r--p 00000000 08:01 9 /usr/lib/locale/C.utf8
Rss:                 512 kB
6000-7000 r--p 00000000 08:01 9 /usr/lib/empty.so
Rss:                   0 kB
"""


def test_each_mapping_counts_for_the_part_of_its_path() -> None:
    parts = memory_parts.by_part(SMAPS)
    assert parts == {"BLAS of numpy and scipy": 3.0, ANONYMOUS: 6.0, OTHERS: 0.5}


def test_this_process_has_python_and_a_heap() -> None:
    parts = memory_parts.resident()
    assert parts["Python"] > 0.5
    assert parts[ANONYMOUS] > 1.0
