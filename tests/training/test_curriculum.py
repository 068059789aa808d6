from __future__ import annotations

import pytest

from model.exceptions import InvalidOptionError
from training.curriculum import Curriculum, Stage


def test_stages_end_by_success_by_plateau_and_by_steps():
    curriculum = Curriculum(
        [
            Stage(max_angle=1, success=0.9),
            Stage(max_angle=10, success=0.9, patience=2),
            Stage(max_angle=20, max_steps=3, success=1.1),
            Stage(max_angle=45),
        ]
    )
    assert not curriculum.judge(0.5)
    assert curriculum.judge(0.95)
    assert curriculum.stage.max_angle == 10
    assert [curriculum.judge(s) for s in (0.3, 0.3, 0.2)] == [False, False, True]
    curriculum.started_at = 10
    assert [curriculum.reach(step) for step in (11, 12, 13)] == [False, False, True]
    assert curriculum.at_last
    assert not curriculum.judge(1.0)
    assert curriculum.stage.max_angle == 45


def test_state_goes_on_where_it_stopped():
    stages = [Stage(max_angle=a, max_steps=5) for a in (1, 10, 20)]
    first, second = Curriculum(stages), Curriculum(stages)
    for step in range(8):
        first.reach(step)
    second.load_state_dict(first.state_dict())
    assert second.index == 1
    assert [second.reach(step) for step in (9, 10)] == [False, True]
    with pytest.raises(InvalidOptionError, match="curriculum"):
        Curriculum(stages[:1]).load_state_dict(first.state_dict())


@pytest.mark.parametrize("angle", [0.0, -5.0, 181.0])
def test_impossible_stages_are_refused(angle):
    with pytest.raises(InvalidOptionError, match="max_angle"):
        Stage(max_angle=angle)
    with pytest.raises(InvalidOptionError, match="empty"):
        Curriculum([])
