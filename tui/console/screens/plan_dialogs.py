"""The dialogs of the scan screen: the plan of the sweep, what is scanned, and the start."""

from __future__ import annotations

from acquire.contract.messaging.messages import Status
from tui.console.screens.dialogs import FormDialog, FormField
from tui.console.state.estimate import Estimate
from tui.console.state.scan_draft import ScanDraft
from tui.console.state.scan_forms import parse_name, parse_plan, parse_words
from tui.text.status_text import scan_name


def plan_dialog(draft: ScanDraft, status: Status | None) -> FormDialog:
    """Answers with the draft that has the typed plan."""
    travel = status.travel_steps if status is not None else (0, 0)
    fields = [
        FormField("first", "first", str(draft.first_steps), help="microsteps, or um (5010um), or mm (5.01mm)"),
        FormField("last", "last", str(draft.last_steps), help="below first sweeps the other way"),
        FormField("steps", "steps per frame", str(draft.steps_per_frame)),
        FormField("settle", "settle ms", f"{draft.settle_ms:g}"),
        FormField("mode", "mode", draft.mode, help="step stops for each frame, fly triggers at constant speed"),
    ]
    return FormDialog("plan", fields, lambda texts: parse_plan(texts, draft, travel))


def words_dialog(draft: ScanDraft) -> FormDialog:
    """Answers with the draft that has the typed name, specimen, operator, notes and tags."""
    fields = [
        FormField("name", "name", draft.name),
        FormField("specimen", "specimen", draft.specimen, words=True),
        FormField("operator", "operator", draft.operator, words=True),
        FormField("notes", "notes", draft.notes, words=True),
        FormField("tags", "tags", " ".join(draft.tags), words=True, help="separated by spaces or commas"),
    ]
    return FormDialog("what is scanned", fields, lambda texts: parse_words(texts, draft))


def start_dialog(draft: ScanDraft, estimate: Estimate, status: Status | None) -> FormDialog:
    """Shows what the sweep takes; answers with its name, by default the draft's, else that of the last scan."""
    last_name = scan_name(status).partition("-")[2] if status is not None else ""
    name = draft.name if draft.name != ScanDraft.name or not last_name else last_name
    lines = [estimate.words(draft), *(f"! {words}" for words in estimate.warnings)]
    if estimate.refused:
        lines.append(f"! it would be refused: {estimate.refused}")
    fields = [FormField("name", "name", name)]
    return FormDialog("start a sweep", fields, lambda texts: parse_name(texts["name"]), done="starts it", lines=lines)
