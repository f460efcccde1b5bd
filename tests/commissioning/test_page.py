"""The page to sign: what was measured, and what was not."""

from linemate.daemon.commissioning.page import PageFacts, page
from linemate.daemon.commissioning.walk import SiteState, StepName, StepOutcome, StepRecordOfSite

FACTS = PageFacts("cell 3", "linemated.yaml", "linemate 1", "2026-01-01", {"camera.yaml": "ab12"})
FIGURE = {"name": "camera x", "unit": "mm", "value": 100.1234, "deviation": 0.06,
          "basis": "18 | postures", "in_overlay": True}  # fmt: skip


def test_the_page_has_every_figure_and_every_step_without_one() -> None:
    state = SiteState(
        {
            StepName.CAMERA: StepRecordOfSite(
                StepOutcome.MEASURED,
                "2026-01-01",
                (FIGURE,),
                "camera.yaml",
                ("a.mcap",),
                took_s=154.6,
            ),
            StepName.FORCE: StepRecordOfSite(StepOutcome.SKIPPED, reason="no sensor"),
            StepName.CONVEYOR: StepRecordOfSite(
                StepOutcome.REFUSED,
                figures=({"name": "direction", "unit": "mrad", "refused": "too short"},),
                reason="too short",
                took_s=40.0,
            ),
        }
    )
    text = page(state, FACTS)
    assert "| camera | measured | 2026-01-01 | 2 min 35 s | a.mcap |" in text
    assert "| conveyor | NOT measured: refused | - | 40 s | - |" in text
    assert "| links | NOT measured | - | - | - |" in text
    assert "All steps together took 3 min" in text
    assert "| camera x * | 100.12 | 0.06 | mm | 18 \\| postures |" in text
    assert "- **force** (frame, sign" in text
    assert "no sensor" in text
    assert "| direction | - |  | mrad | refused: too short |" in text
    for name in StepName:
        if name not in {StepName.CAMERA, StepName.PAGE}:
            assert f"- **{name.value}** (" in text
    assert "| camera.yaml | `ab12` |" in text
    assert "| name | date | signature |" in text
    assert "took" not in page(SiteState(), FACTS).replace("| took |", "")
