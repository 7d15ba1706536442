"""The teacher's wall: all places of a classroom live, tasks, results, a look at each place."""

from typing import Any

from nicegui import Client, run, ui

from ....drive.diagrams import State, mode_words
from ..classroom import Classroom, Place
from ..guard import PERSON
from .widgets import DARK_OR_LIGHT, Tag, box, button, card, div, formatted, lit, styled, sure

EVERY = 0.5  # s between two pictures
FREE = "free practice"
KINDS = {State.OPERATION_ENABLED: "good", State.FAULT: "bad", State.FAULT_REACTION_ACTIVE: "bad"}


class PlaceCard:
    """A place on the wall."""

    def __init__(self, room: Classroom, place: Place):
        self.room, self.place = room, place
        name = f"place-{place.number}"
        with Tag("section", data_test=name, aria_label=place.name).classes(
            "card place"
        ) as self.card:
            with div("place-head"):
                Tag("h2", f"{place.number}. {place.name}")
                self.here = Tag("span", "").classes("place-here")
            with div("cluster place-state"):
                self.state = Tag("span", "", data_test=f"{name}-state").classes("state-chip")
                self.mode = Tag("span", "").classes("mono")
                self.position = Tag("span", "", data_test=f"{name}-position").classes("mono")
            self.doing = Tag("p", "").classes("place-doing")
            self.task = Tag("p", "", data_test=f"{name}-task").classes("place-task")
            self.more = Tag("p", "", data_test=f"{name}-more").classes("place-more quiet")
            with div("cluster place-buttons"):
                Tag(
                    "a", "Look", href=f"place/{place.number}", target="_blank",
                    data_test=f"{name}-look", aria_label=f"Look at {place.name}",
                ).classes("btn place-look")
                for text, click, spoken in (
                    ("Code", self._code, "Own code of place"),
                    ("Reset", self._reset, "Reset the machine of"),
                    ("Remove", self._remove, "Remove place"),
                ):
                    button(text, click, f"{name}-{text.lower()}",
                           props=f'aria-label="{spoken} {place.number}"')

    def _code(self) -> None:
        """Show the code only on request, because the wall may be on a projector."""
        ui.notify(f"{self.place.name} comes in again with the own code {self.place.code}",
                  position="bottom-left", timeout=8000, close_button="Close")

    async def _reset(self) -> None:
        if await sure(f"Reset the machine of {self.place.name} to its initial state?"):
            self.room.reset(self.place)

    async def _remove(self) -> None:
        if await sure(
            f"Remove {self.place.name}? The machine is gone, the results stay in the files."
        ):
            await run.io_bound(self.room.remove, self.place)
            for client in [*Client.instances.values()]:
                request = client.request
                if request is not None and request.scope.get(PERSON) is self.place:
                    client.run_javascript("location.reload()")

    def show(self, here: bool) -> None:
        """Show the present state of the place."""
        shown: dict[str, Any] = self.place.clock.shown
        axes = shown["axes"]
        worst = max(axes, key=lambda axis: KINDS.get(axes[axis]["state"], "") == "bad")
        seen = axes[worst]
        state = State(seen["state"])
        self.state.say(state.name.replace("_", " ").lower())
        for kind in ("good", "bad"):
            lit(self.state, kind, KINDS.get(state) == kind)
        self.mode.say(mode_words(seen["mode"]).name if seen["mode"] else "no mode")
        unit, _ = self.place.clock.session.unit(worst)
        self.position.say(f"{formatted(seen['position'], 1)} {unit}")
        self.here.say("here" if here else "away")
        lit(self.here, "good", here)
        self.doing.say(seen["fault"] or shown["doing"] or shown["agent"])
        lit(self.doing, "bad", bool(seen["fault"]))
        task, wrong, done, hints = "no exercise", "", False, []
        if lesson := shown["lesson"]:
            wrong, done, hints = lesson.wrong, not lesson.text, [f"hints {lesson.used}"]
            at = min(lesson.step + 1, lesson.steps)
            task = f"{lesson.title} · {at} of {lesson.steps}: {wrong or lesson.text or 'done'}"
        self.task.say(task)
        lit(self.task, "bad", bool(wrong))
        lit(self.task, "done", done)
        finished = f"{len(self.place.done)} of {len(self.room.exercises)} done"
        self.more.say(" · ".join([*hints, finished, f"{len(self.place.results)} tries"]))


class Wall:
    """All places.

    Args:
        room: the classroom.
        address: address that the pupils open.
    """

    def __init__(self, room: Classroom, address: str):
        self.room = room
        self.cards: dict[int, PlaceCard] = {}
        self.dark = styled()
        titles = {each.name: each.title for each in room.exercises}
        with ui.element("header").classes("top wall-top"):
            with div("brand"):
                Tag("h1", "servogym")
                Tag("span", "classroom")
            Tag("span", f"{address} · code ", data_test="where").classes("wall-where")
            Tag("b", room.word, data_test="word").classes("mono")
            self.count = Tag("span", "", data_test="count").classes("quiet")
            ui.space()
            self.open = ui.switch("New pupils may come", value=room.open, on_change=self._open)
            self.open.props("data-test=open")
            button("", self.dark.toggle, "theme", "icon", DARK_OR_LIGHT)
            button("QUICK STOP ALL", room.stop, "stop-all", "stop")
        with div("content wall"):
            with card("Task for all", "task"), div("cluster"):
                task = room.task.name if room.task else ""
                self.task = box(ui.select({"": FREE} | titles, value=task, label="Exercise"),
                                "task-name", props="options-dense")
                button("Give", self._give, "give", "main")
                ui.space()
                button("Results as CSV", self._csv, "csv")
            self.grid = div("places", "places")
        ui.timer(EVERY, self.show)

    def _open(self) -> None:
        self.room.open = bool(self.open.value)

    async def _give(self) -> None:
        chosen = {each.name: each for each in self.room.exercises}.get(str(self.task.value))
        what = f"Begin “{chosen.title}” on all machines now?" if chosen else "End the task for all?"
        if await sure(f"{what} This ends what pupils are doing." if chosen else what):
            self.room.give(chosen)

    def _csv(self) -> None:
        ui.download.content(self.room.csv().encode(), "results.csv", "text/csv")

    def show(self) -> None:
        """Show the present state."""
        places = self.room.places
        for number, known in [*self.cards.items()]:
            if places.get(number) is not known.place:
                self.cards.pop(number).card.delete()
        for number in sorted(places.keys() - self.cards.keys()):
            with self.grid:  # the other cards stay, so that their open dialogs do too
                self.cards[number] = PlaceCard(self.room, places[number])
            self.cards[number].card.move(self.grid, sorted(self.cards).index(number))
        here = {
            id(client.request.scope.get(PERSON))
            for client in [*Client.instances.values()]
            if client.request is not None and client.has_socket_connection
        }
        for each in self.cards.values():
            each.show(id(each.place) in here)
        self.count.say(f"{len(places)} of {self.room.most} places")


async def show_wall(room: Classroom, address: str) -> None:
    """Build the wall in a tab that has just been opened."""
    await ui.context.client.connected()
    ui.page_title("servogym classroom")
    ui.run_javascript('document.documentElement.lang = "en"')
    Wall(room, address)
