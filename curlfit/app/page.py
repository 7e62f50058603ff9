"""The page: a file, what was read, law, stone and further options, and what the
commands found."""

from __future__ import annotations

import asyncio
import shlex
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial, wraps
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

from cyclopts import App
from nicegui import events, ui

from curlfit.app.form import (
    Written,
    flags_of,
    help_of,
    proposals,
    values_of,
    words_for,
)
from curlfit.app.reading import Seen, look
from curlfit.app.work import Work
from curlfit.errors import CurlfitError, InputError, Option
from curlfit.foreign import message, safe_name
from curlfit.friction import LAWS
from curlfit.html_report.blocks import Commands, marked, sentence
from curlfit.html_report.page import rendered, source
from curlfit.output.document import command_line
from curlfit.settings.choices import Fitting
from curlfit.settings.forms import SWITCH
from curlfit.throws.channels import CHANNELS

MOST_BYTES = 100_000_000
"""Largest upload, of twice as much as is read of a file."""
_MOST_FILES = 1000  # which the server takes at once
_TOO_MUCH = (
    f"The page takes at most {_MOST_FILES} files and {MOST_BYTES // 10**6} MB at once; "
    "nothing was read. `curlfit batch` takes folders of any number"
)
_SUFFIXES = (
    ".csv",
    ".tsv",
    ".txt",
    ".json",
    ".jsonl",
    ".xlsx",
    ".xls",
    ".ods",
    ".toml",
)


@dataclass(frozen=True)
class _Verb:
    """A command: the label of its button, and the heading of its result."""

    label: str
    heading: str


_VERBS = {
    "fit": _Verb("Fit", "The fit"),
    "compare": _Verb("Compare laws", "The comparison"),
}
# A report is no part of this page, to which it says how high it is and where to scroll.
_FRAMES = """<script>
addEventListener("message", ({source, data}) => {
  for (const frame of document.querySelectorAll("iframe")) {
    if (source !== frame.contentWindow) continue;
    if (Number.isFinite(data.height))
      frame.style.height = `${Math.min(data.height, 1e6) + 60}px`;
    if (Number.isFinite(data.top))
      scrollTo(0, scrollY + frame.getBoundingClientRect().top + data.top);
  }
});
</script>"""
_TOO_MANY = (
    f':filter="files => files.length > {_MOST_FILES} || '
    f'files.reduce((sum, file) => sum + file.size, 0) > {MOST_BYTES} ? [] : files"'
)
# of files of one name, NiceGUI would keep the last
_APART = ':field-name="file => file.__key"'


class Page:
    """The page and what is on it; one, whatever number of windows shows it.

    Parameters
    ----------
    cli : the commands. start : where results are saved.
    folder : of the files dropped, and of what the commands write.

    Attributes
    ----------
    written : law, stone and further options. refused : why these are none of a fit.
    beside : files for options. seen : what was read, with the last options that were
        not refused.
    work, done : the command that runs, and those that ended, by verb.
    """

    def __init__(self, cli: App, start: Path, folder: Path) -> None:
        self.cli = cli
        self.start = start
        self.folder = folder
        self.flags = {verb: flags_of(cli, verb) for verb in _VERBS}
        self.help = help_of(cli, "fit")
        self.work: Work | None = None
        self._forget()
        self.parts = [
            ui.refreshable(_standing_alone(part))
            for part in (self._read, self._choices, self._results)
        ]
        self._readings = 0  # how often the files were read, or replaced

    def _forget(self) -> None:
        """Begin without files, choices and results."""
        self.files: list[Path] = []
        self.beside: list[str] = []
        self.written = Written()
        self.refused = ""
        self.seen = Seen()
        self.done: dict[str, Work] = {}

    def build(self) -> None:
        """Make the elements of the page."""
        ui.add_css(
            source("report.css")
            + (resources.files(__package__) / "page.css").read_text()
        )
        ui.add_head_html(_FRAMES)
        with _box("header"):
            _tag("h1", "curlfit")
            _tag(
                "p",
                "What the ice did to a stone, and what its path cannot tell.",
                "subject",
            )
        upload = ui.upload(
            label="Drop a file here, or click",
            multiple=True,
            auto_upload=True,
            on_multi_upload=self.receive,
            on_rejected=self.refuse,
        )
        upload.props("flat").props(_TOO_MANY).classes("drop")
        upload.props(_APART)
        upload.on("failed", self.refuse, args=[])
        upload.on("finish", upload.reset, args=[])
        _tag(
            "p",
            "A path (t, x, y, angle), times by stopwatch, or friction against speed; "
            "several files at once are fitted together. Nothing leaves this computer.",
            "note",
        )
        with _box("datalist", id="--law"):
            for name in LAWS:
                _tag("option", value=name)
        with _box("main"):
            for part in self.parts:
                part()

    def refresh(self) -> None:
        """Show all as it is now."""
        for part in self.parts:
            part.refresh()

    # What is done

    async def receive(self, event: events.MultiUploadEventArguments) -> None:
        """Take files in place of those before."""
        if self.work is not None:
            self.work.kill()
            await self.work.over.wait()
        for path in self.folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self._forget()
        for file in event.files:
            name = self._free_name(file.name)
            await file.save(self.folder / name)
            self.files.append(Path(name))
        await self.look_again()

    def _free_name(self, name: str) -> str:
        """The name of a dropped file in the folder: that of no other file there, and
        none that a program looks for, as `numpy.py` or `matplotlibrc`."""
        path = Path(safe_name(name.replace("`", "'")))
        if path.suffix.lower() not in _SUFFIXES:
            path = Path(f"{path}.txt")
        number = 1
        free = path
        while (self.folder / free).exists():
            number += 1
            free = path.with_stem(f"{path.stem}_{number}")
        return str(free)

    def refuse(self) -> None:
        """Say why files were not taken."""
        self._readings += 1
        self.seen = Seen(fault=_TOO_MUCH)
        self.refresh()

    def fail(self, error: Exception) -> None:
        """Say that something went wrong which is not the user's fault."""
        self._readings += 1
        self.seen = Seen(fault=_own_error(error))
        self.refresh()

    async def receive_beside(
        self, name: str, event: events.UploadEventArguments
    ) -> None:
        """Take a file that an option names; of a flag, if its name is given, which then
        names the file."""
        file = self._free_name(event.file.name)
        await event.file.save(self.folder / file)
        self.beside.append(file)
        if name:
            await self.put(self.written.with_option(self.flags["fit"][name], file))
        else:
            self.refresh()

    async def put(self, written: Written) -> None:
        """Take what is written in place of what was, and read the files with it."""
        self.written = written
        await self.look_again()

    async def look_again(self) -> None:
        """Read the files with the choices as they are; what was read with earlier ones,
        and took longer, is dropped."""
        self._readings += 1
        reading = self._readings
        try:
            chosen = values_of(self.cli, self.written.words())
        except CurlfitError as error:
            self.refused = str(error)
            self.refresh()
            return
        self.refused = ""
        try:
            seen = await asyncio.to_thread(look, self.files, chosen)
        except CurlfitError as error:
            seen = Seen(fault=str(error), options=error.options)
        if reading == self._readings:
            self.seen = seen
            self.refresh()

    @property
    def can_fit(self) -> bool:
        """Whether neither the options nor what was read is at fault."""
        return not self.refused and not self.seen.fault

    async def accept(self, name: str, text: str, verb: str) -> None:
        """Follow a proposal; one of a result, by running its command again."""
        await self.put(self.written.with_option(self.flags["fit"][name], text))
        if verb and self.can_fit:
            await self.carry_out(verb)

    async def carry_out(self, verb: str) -> None:
        """Run a command on the files, and show its page."""
        if self.work is not None:
            return
        try:
            words = self._words(verb)
        except InputError:  # which is said below the line
            return
        work = Work(verb, words)
        self.work = work
        self.done.pop(verb, None)
        self.parts[-1].refresh()
        try:
            await work.run(self.folder)
        finally:
            self.work = None
            if not work.stopped:
                self.done = {verb: work, **self.done}
            self.parts[-1].refresh()

    def _words(self, verb: str) -> list[str]:
        """The words of a command. Raises `InputError` where the line is none."""
        options = words_for(self.flags[verb], self.written.words())
        return [*map(str, self.files), *options, "--report"]

    def close(self) -> None:
        """End the command that runs, at once."""
        if self.work is not None:
            self.work.kill()

    def save(self, folder: Path, destination: str) -> str:
        """Copy a folder to a destination where there is nothing yet; returns a sentence
        that says whether it was."""
        target = self.start / Path(destination).expanduser()
        try:
            return f"Written: {shutil.copytree(folder, target)}"
        except FileExistsError:
            return f"{target} exists already; give another name"
        except (OSError, shutil.Error) as error:
            return f"{target}: cannot be written ({error})"

    # What is shown

    def _read(self) -> None:
        """What was read: its fault, oddities, figures and notes."""
        if not self.files and not self.seen.fault:
            return
        with _box("section", "h2", "What was read"):
            _tag("h3", ", ".join(map(str, self.files)))
            _tag("p", self.seen.finding)
            self._say(self.seen.fault, "finding bad", self.seen.options)
            for oddity in self.seen.oddities:
                self._say(str(oddity), "warned", oddity.options)
            if self.seen.shown:
                # on which figures are drawn
                paper = "card" if "<svg" in self.seen.shown else ""
                ui.html(self.seen.shown, sanitize=False).classes(f"seen {paper}")
            for note in self.seen.notes:
                self._say(str(note), "note", note.options)
            if self.seen.text:
                with _box("details", "summary", "As curlfit check prints it"):
                    _tag("pre", self.seen.text, "wide")

    def _say(
        self, text: str, role: str, options: Iterable[Option] = (), verb: str = ""
    ) -> None:
        """A sentence, and beneath it what it proposes; the command of a verb then runs
        again."""
        if not text:
            return
        with _box("div", role=role):
            ui.html(marked(sentence(text, CHANNELS)), sanitize=False)
            for name, value in proposals(self.flags["fit"], options):
                if not value:
                    self._file(f"Choose the file for {name}", name)
                    continue
                is_switch = self.flags["fit"][name].form is SWITCH
                option = name if is_switch else f"{name} {value}"
                _button(f"Apply {option}", partial(self.accept, name, value, verb))

    def _choices(self) -> None:
        """Law, stone, further options, and the buttons of the commands."""
        if not self.files:
            return
        with _box("section", "h2", "Choices"):
            with _box("div", role="fields"):
                self._input("law", "Law", Fitting.usual["law"], list="--law")
                self._input("stone", "Stone", self.flags["fit"]["--stone"].written)
            hint = "--until 18 --noise ar1"
            self._input("line", "Further options, as on the command line", hint)
            if self.refused:  # in the user's words, of which no button is made
                _tag("p", sentence(self.refused, CHANNELS), "finding bad")
            with _box("details", "summary", "All options (curlfit fit --help)"):
                _tag("pre", self.help, "wide")
            self._file("Choose a file for an option")
            if self.beside:
                _tag("p", f"There: {shlex.join(self.beside)}", "note")
            if not self.refused:
                _command("fit", self._words("fit"))
            with _box("div", role="acts"):
                for name, verb in _VERBS.items():
                    button = _button(verb.label, partial(self.carry_out, name))
                    button.classes(f"to-{name}")
                    button.props["disabled"] = not self.can_fit

    def _input(self, name: str, heading: str, hint: str, **attributes: str) -> None:
        """A field of what is written."""
        with _box("label", "span", heading, "field"):
            text = getattr(self.written, name)
            field = _tag("input", type="text", value=text, placeholder=hint)
            field.props.update(attributes)
            field.props["aria-label"] = heading

        async def take(event: events.GenericEventArguments) -> None:
            await self.put(replace(self.written, **{name: event.args}))

        field.on("change", take, js_handler="e => emit(e.target.value)")

    def _file(self, label: str, name: str = "") -> None:
        """A place for a file that an option names; of a flag, if its name is given."""
        take = partial(self.receive_beside, name)
        upload = ui.upload(label=label, auto_upload=True, on_upload=take)
        upload.props("flat").classes("beside")

    def _results(self) -> None:
        """The command that runs, and the pages of those that ended."""
        if self.work is not None:
            with _box("section", "h2", "At work"):
                status = ui.html("", sanitize=False).classes("status")
                status.bind_content_from(self.work, "progress")
                _button("Stop", self.work.stop)
        for number, work in enumerate(self.done.values()):
            heading = _VERBS[work.verb].heading
            with _box("details", "summary", heading, "result", open=number == 0):
                for text in work.complaints:
                    self._say(text, "finding bad")
                for warning in work.warnings:
                    if proposals(self.flags["fit"], warning.options):
                        self._say(str(warning), "warned", warning.options, work.verb)
                if work.page is not None:
                    self._page_of(work, work.page)

    def _page_of(self, work: Work, page: Path) -> None:
        """The page that a command wrote, its command, and where to save it."""
        with _box("div", role="repeat"):
            line = _command(work.verb, work.words)
            _button("Copy", partial(ui.clipboard.write, line))
        with _box("div", role="repeat"):
            with _box("label", "span", f"Folder, in {self.start}", "field"):
                _tag("input", type="text", value=str(page.parent))
            ask = "e => emit(e.target.closest('.repeat').querySelector('input').value)"
            button = _tag("button", "Save")
        outcome = _tag("p", role="status")

        def save(destination: str) -> None:
            text = self.save(self.folder / page.parent, destination)
            outcome.set_content(escape(text))

        button.on("click", lambda e: save(e.args), js_handler=ask)
        _tag("iframe", src=f"results/{page}?{id(work)}", title="Report")


def _standing_alone(part: Callable[[], None]) -> Callable[[], None]:
    """A part of the page; an error in it leaves the other parts as they are."""

    @wraps(part)
    def drawn() -> None:
        try:
            part()
        except Exception as error:
            _tag("p", _own_error(error), "finding bad")

    return drawn


def _own_error(error: Exception) -> str:
    """An error that is not the user's."""
    text = message(f"{type(error).__name__}: {error}")
    return "This is an error of curlfit: " + text.replace("`", "'")


def _tag(name: str, text: str = "", role: str = "", **attributes: Any) -> ui.html:
    """An element with a text; its role is a class of the style sheet."""
    element = ui.html(escape(text), sanitize=False, tag=name).classes(role)
    element.props.update(attributes)
    return element


def _box(
    name: str, head: str = "", text: str = "", role: str = "", **attributes: Any
) -> ui.element:
    """An element that others enter, with a heading."""
    with ui.element(name).classes(role) as element:
        if head:
            _tag(head, text)
    element.props.update(attributes)
    return element


def _button(text: str, act: Callable[..., Any]) -> ui.element:
    """A button that does something when it is clicked."""
    return _tag("button", text).on("click", act)


def _command(verb: str, words: Sequence[str]) -> str:
    """Show a command as it is typed, and return it."""
    line = command_line(verb, *words)
    ui.html(rendered(Commands([line])), sanitize=False)
    return line
