"""The page: a file, what was read, choices, and what the commands found."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

from cyclopts import App
from nicegui import events, ui

from curlfit.app.form import Field, fields_of, merged, proposals, values_of, words_of
from curlfit.app.reading import Seen, look
from curlfit.app.work import Work
from curlfit.errors import CurlfitError
from curlfit.foreign import safe_name
from curlfit.friction import LAWS
from curlfit.html_report.blocks import Block, marked, sentence
from curlfit.html_report.page import rendered, source
from curlfit.output.document import command_line
from curlfit.settings.choices import LAW
from curlfit.settings.forms import SWITCH, OneOf
from curlfit.throws.throw import CHANNELS

MOST_BYTES = 100_000_000
"""Largest upload, of twice as much as is read of a file."""
VERBS = {"fit": "Fit", "compare": "Compare laws"}
_RESULTS = {"fit": "The fit", "compare": "The comparison"}
_FIRST = ("--law", "--load", "--stone", "--noise")
_HEADINGS = {
    "--law": "Law, load, stone, noise", "Parameters": "More about the model",
    "How to read DATA": "How the file is read", "Sampling": "Sampling of the posterior",
}  # fmt: skip
_HEIGHT = (  # as high as what it shows, at any width
    "const page = this.contentDocument.documentElement; const fit = () => {"
    "this.style.height = this.contentDocument.body.offsetHeight + 60 + 'px'};"
    "new ResizeObserver(fit).observe(this.contentDocument.body); fit()"
)


@dataclass
class Result:
    """What a command found: its words, its complaints, and the folder that it wrote."""

    verb: str
    words: Sequence[str]
    complaints: Sequence[str]
    folder: Path | None
    warnings: Sequence[str] = ()
    saved: str = ""


@dataclass
class Page:
    """The page and what is on it; one, whatever number of windows shows it.

    Attributes
    ----------
    cli : the commands. start : where results are saved. folder : of the files dropped, and of
        what the commands write.
    files : names of the data. written : what is in the fields, by flag.
    """

    cli: App
    start: Path
    folder: Path
    files: list[Path] = field(default_factory=list)
    written: dict[str, str] = field(default_factory=dict)
    seen: Seen = field(default_factory=Seen)
    results: dict[str, Result] = field(default_factory=dict)
    work: Work | None = None

    def __post_init__(self) -> None:
        self.fields = {verb: fields_of(self.cli, verb) for verb in VERBS}
        self.show_seen = ui.refreshable(self._show_seen)
        self.show_choices = ui.refreshable(self._show_choices)
        self.show_results = ui.refreshable(self._show_results)

    def build(self) -> None:
        """The elements of the page."""
        ui.add_css(source("report.css") + (resources.files(__package__) / "page.css").read_text())
        with ui.element("header"):
            _tag("h1", "curlfit")
            _text("What the ice did to a stone, and what its path cannot tell.", "subject")
        ui.upload(
            label="Drop a file here, or click", multiple=True, auto_upload=True,
            on_multi_upload=self.receive, max_total_size=MOST_BYTES, on_rejected=self.refuse,
        ).props("flat").classes("drop")  # fmt: skip
        _text(
            "A path (t, x, y, angle), times by stopwatch, or friction against speed; several files "
            "at once are fitted together. Nothing leaves this computer.", "note",
        )  # fmt: skip
        with ui.element("main"):
            self.show_seen()
            self.show_choices()
            self.show_results()

    # What is done

    async def receive(self, event: events.MultiUploadEventArguments) -> None:
        """Take files in place of those before."""
        if self.work is not None:
            self.work.stop()
            await self.work.over.wait()
        for path in self.folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self.files, self.written, self.results = [], {}, {}
        for file in event.files:
            self.files.append(Path(safe_name(file.name)))
            await file.save(self.folder / self.files[-1])
        event.sender.run_method("reset")
        await self.look_again()

    async def receive_beside(self, flag: str, event: events.UploadEventArguments) -> None:
        """Take the file of a field."""
        name = safe_name(event.file.name)
        await event.file.save(self.folder / name)
        await self.put(flag, name)

    async def put(self, flag: str, text: str, *, add: bool = False) -> None:
        """Set a field, and read the files with it."""
        before = self.written.pop(flag, "")
        if text:
            self.written[flag] = merged(self.fields["fit"][flag], before, text) if add else text
        await self.look_again()

    async def look_again(self) -> None:
        """Read the files with the choices as they are."""
        try:
            chosen = values_of(self.fields["fit"], self.written)
        except CurlfitError as error:
            self.seen = Seen(fault=str(error))
        else:
            self.seen = await asyncio.to_thread(look, self.files, chosen) if self.files else Seen()
        for part in (self.show_seen, self.show_choices, self.show_results):
            part.refresh()

    async def carry_out(self, verb: str) -> None:
        """Run a command on the files, and show its page."""
        if self.work is not None:
            return
        words = self._words(verb)
        work = self.work = Work()
        self.results.pop(verb, None)
        self.show_results.refresh()
        done = await work.run([verb, *words], self.folder)
        self.work = None
        if not work.stopped:
            folder = done.page.parent if done.page else None
            self.results = {
                verb: Result(verb, words, done.complaints, folder, _warnings(folder)),
                **self.results,
            }
        self.show_results.refresh()

    def _words(self, verb: str) -> list[str]:
        return [*map(str, self.files), *words_of(self.fields[verb], self.written), "--report"]

    async def accept(self, flag: str, text: str, verb: str) -> None:
        """Follow a proposal; one of a result, by running its command again."""
        await self.put(flag, text, add=True)
        if verb and not self.seen.fault:
            await self.carry_out(verb)

    def refuse(self) -> None:
        """Say why a file was not taken."""
        self.seen = Seen(fault=f"The file has more than {MOST_BYTES // 10**6} MB; nothing was read")
        self.show_seen.refresh()

    def close(self) -> None:
        """End the command that runs, at once."""
        if self.work is not None:
            self.work.stop()
            self.work.stop()

    def save(self, result: Result, place: str) -> None:
        """Copy the folder of a result to a place where there is nothing yet."""
        target = self.start / Path(place).expanduser()
        assert result.folder is not None
        try:
            shutil.copytree(result.folder, target)
            result.saved = f"Written: {target}"
        except FileExistsError:
            result.saved = f"{target} exists already; give another name"
        except (OSError, shutil.Error) as error:
            result.saved = f"{target}: cannot be written ({error})"
        self.show_results.refresh()

    # What is shown

    def _show_seen(self) -> None:
        if not self.files and not self.seen.fault:
            return
        with _section("What was read"):
            _tag("h3", ", ".join(map(str, self.files)))
            _text(self.seen.finding)
            if self.seen.fault:
                self._say(self.seen.fault, "finding bad")
            for text in self.seen.oddities:
                self._say(text, "warned")
            if self.seen.shown:
                ui.html(self.seen.shown, sanitize=False).classes("card seen")
            for text in self.seen.notes:
                self._say(text, "note")
            if self.seen.text:
                with _folded("As curlfit check prints it"), ui.element("div").classes("wide"):
                    _tag("pre", self.seen.text)

    def _say(self, text: str, role: str, verb: str = "") -> None:
        """A sentence, and beneath it what it proposes."""
        with ui.element("div").classes(role):
            ui.html(marked(sentence(text, CHANNELS)), sanitize=False)
            for flag, value in proposals(self.fields["fit"], text):
                if value:
                    shown = flag if self.fields["fit"][flag].form is SWITCH else f"{flag} {value}"
                    _button(f"Apply {shown}", partial(self.accept, flag, value, verb))
                else:
                    self._file(flag)

    def _file(self, flag: str) -> None:
        chosen = self.written.get(flag, "")
        label = f"{flag}: {chosen}" if chosen else f"Choose the file for {flag}"
        ui.upload(
            label=label, auto_upload=True, on_upload=partial(self.receive_beside, flag)
        ).props("flat").classes("beside-file")  # fmt: skip

    def _show_choices(self) -> None:
        if not self.files:
            return
        fields = self.fields["fit"]
        groups: dict[str, list[Field]] = {_HEADINGS["--law"]: [fields[flag] for flag in _FIRST]}
        for one in fields.values():
            if one.flag not in _FIRST:
                groups.setdefault(_HEADINGS.get(one.group, one.group), []).append(one)
        with _section("Choices"):
            for heading, group in groups.items():
                with _folded(heading, self.written.keys() & {one.flag for one in group}):
                    self._show_fields(group)
            _command("fit", self._words("fit"))
            with ui.element("div").classes("acts"):
                for verb, label in VERBS.items():
                    off = "disabled" if self.seen.fault else ""
                    _button(label, partial(self.carry_out, verb)).props(off).classes(f"to-{verb}")

    def _show_fields(self, fields: Sequence[Field]) -> None:
        with ui.element("div").classes("fields"):
            for one in fields:
                with ui.element("label").classes("field"):
                    _tag("span", one.flag.removeprefix("--").replace("-", " "))
                    self._show_input(one)
                    ui.html(marked(one.help), sanitize=False).classes("note")

    def _show_input(self, one: Field) -> None:
        if one.takes_file:
            return self._file(one.flag)
        value = self.written.get(one.flag, "")
        emitted = "e.target.value"
        if one.form is SWITCH:
            found = ui.element("input").props("type=checkbox" + " checked" * bool(value))
            emitted = "e.target.checked ? 'yes' : ''"
        elif isinstance(one.form, OneOf):
            with ui.element("select") as found:
                for name in ("", *one.form.names):
                    choice = _tag("option", name or f"{one.usual}, the default")
                    choice.props.update(value=name, selected=name == value)
        else:
            found = ui.element("input")
            found.props.update(value=value, placeholder=one.usual or one.written, type="text")
            if one.form is LAW:
                found.props["list"] = "laws"
                with ui.element("datalist").props("id=laws"):
                    for name in LAWS:
                        ui.element("option").props["value"] = name
        found.props["aria-label"] = one.flag
        found.on("change", lambda e: self.put(one.flag, e.args), js_handler=f"e => emit({emitted})")
        return None

    def _show_results(self) -> None:
        if self.work is not None:
            self._show_work(self.work)
        for place, result in enumerate(self.results.values()):
            with _folded(_RESULTS[result.verb], place == 0).classes("result"):
                self._show_result(result)

    def _show_work(self, work: Work) -> None:
        with _section("At work"):
            says = _tag("p", work.says).classes("status")
            bar = ui.element("progress")

            def tell() -> None:
                says.set_content(escape("Stopping" if work.stopped else work.says))
                if work.share is None:
                    bar.props(remove="value")
                else:
                    bar.props(f"value={work.share}")

            ui.timer(0.3, tell)
            _button("Stop", work.stop)

    def _show_result(self, result: Result) -> None:
        for text in result.complaints:
            self._say(text, "finding bad", result.verb)
        if result.folder is None:
            return
        for text in result.warnings:
            if proposals(self.fields["fit"], text):
                self._say(text, "warned", result.verb)
        with ui.element("div").classes("repeat"):
            line = _command(result.verb, result.words)
            _button("Copy", partial(ui.clipboard.write, line))
        with ui.element("div").classes("repeat"):
            with ui.element("label").classes("field"):
                _tag("span", f"Folder, in {self.start}")
                place = ui.element("input")
                place.props.update(value=result.folder.name, type="text")
            ask = "e => emit(e.target.closest('.repeat').querySelector('input').value)"
            _tag("button", "Save").on("click", lambda e: self.save(result, e.args), js_handler=ask)
        if result.saved:
            _text(result.saved, "status")
        address = f"results/{result.folder.name}/report.html?{id(result)}"
        ui.html(
            f'<iframe src="{address}" title="Report" onload="{_HEIGHT}"></iframe>', sanitize=False
        )


def _warnings(folder: Path | None) -> Sequence[str]:
    """The warnings of a saved result."""
    import curlfit
    from curlfit.options.settings import kind_of
    from curlfit.output.display import KINDS, document_of

    if folder is None:
        return ()
    try:
        noun = KINDS[kind_of(folder)].noun
        return document_of(getattr(curlfit, f"load_{noun}")(folder)).warnings
    except CurlfitError:  # a law of the user's own
        return ()


def _tag(name: str, text: str) -> ui.html:
    return ui.html(escape(text), sanitize=False, tag=name)


def _section(heading: str) -> ui.element:
    with ui.element("section") as found:
        _tag("h2", heading)
    return found


def _folded(summary: str, opened: object = False) -> ui.element:
    with ui.element("details") as found:
        _tag("summary", summary)
    found.props["open"] = bool(opened)
    return found


def _command(verb: str, words: Sequence[str]) -> str:
    line = command_line(verb, *words)
    ui.html(rendered(Block("commands", {"lines": [line]})), sanitize=False)
    return line


def _text(text: str, role: str = "") -> None:
    ui.html(marked(text), sanitize=False, tag="p").classes(role)


def _button(text: str, act: Callable[..., Any]) -> ui.element:
    return _tag("button", text).on("click", act)
