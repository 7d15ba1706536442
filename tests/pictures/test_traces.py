"""The picture of channels over time, from a machine, a bus or a log."""

from later import Later

from servogym.drive.kernel.words import state_of
from servogym.drive.trace import Recording

Figure = Later("matplotlib.figure", "Figure")
draw = Later("servogym.training.pictures.traces", "draw")

# statuswords of all states but the one without power, as a day with a fault has them
DAY = (0x0250, 0x0231, 0x0233, 0x0237, 0x0217, 0x021F, 0x0218)


def test_no_title_or_state_lies_on_another_or_is_cut_off(tmp_path, monkeypatch):
    drawn = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda self, *a, **k: (drawn.append(self), save(self, *a, **k))
    )
    assert len({state_of(word) for word in DAY}) == len(DAY)
    recording = Recording({"statusword": "", "position_actual_value": "position unit"})
    for n, word in enumerate(DAY):
        recording.add(n * 0.1, (word, 1000 * n))
    draw(recording, tmp_path / "scope.png")
    (figure,) = drawn
    written = [axes.title for axes in figure.axes] + figure.legends[0].get_texts()
    boxes = [(text.get_text(), text.get_window_extent()) for text in written]
    assert {"statusword", "switch on disabled", "fault reaction active"} <= {t for t, _ in boxes}
    for i, (text, box) in enumerate(boxes):
        assert box.x0 >= 0 <= box.y0, text
        assert box.x1 <= figure.bbox.x1, text
        assert box.y1 <= figure.bbox.y1, text
        for other, other_box in boxes[i + 1 :]:
            assert not box.overlaps(other_box), f"{text} on {other}"
