# SPDX-License-Identifier: Apache-2.0
"""Numbers among the arguments of programs."""

from __future__ import annotations

import pytest

from tpgmm_ros.programs import convert, recognize, train

TRAIN = ["--task", "task.yaml", "--output", "model", "bag"]
CONVERT = ["--to", "bags", "--movement", "x,y", "a.csv"]
RECOGNIZE = ["--task", "task.yaml", "--skill", "a=a.tpgmm", "bag"]


@pytest.mark.parametrize(
    ("program", "arguments", "words"),
    [
        (train, ["--every", "x", *TRAIN], "argument --every: 'x' is not a whole number of at least 1"),
        (train, ["--components", "0", *TRAIN], "argument --components: '0' is not a whole number of at least 1"),
        (train, ["--seed", "-1", *TRAIN], "argument --seed: '-1' is not a whole number from 0 to 4294967295"),
        (convert, ["--rate", "fast", *CONVERT], "argument --rate: 'fast' is not a rate in Hz, a number above 0"),
        (convert, ["--rate", "inf", *CONVERT], "argument --rate: 'inf' is not a rate in Hz, a number above 0"),
        (recognize, ["--every", "0", *RECOGNIZE], "argument --every: '0' is not a whole number of at least 1"),
        (recognize, ["--memory", "nan", *RECOGNIZE], "argument --memory: 'nan' is not a time in s, a number above 0"),
    ],
)
def test_numbers_that_are_none_or_out_of_range_are_refused_in_words(
    program: object, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        program.main(arguments)  # type: ignore[attr-defined]
    assert ended.value.code == 2 and words in capsys.readouterr().err
