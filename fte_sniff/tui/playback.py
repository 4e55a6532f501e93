"""Freeze the view of a capture; play a file."""

from __future__ import annotations

from time import monotonic_ns

from fte_sniff.tui.i18n import _
from fte_sniff.tui.prompt import Parts


class PlaybackControl:
    """Pauses the view, and plays a file from the cursor's row on."""

    def __init__(self, parts: Parts) -> None:
        self._model, self._table = parts.model, parts.table
        self._panes, self._notice = parts.panes, parts.notice
        speed = parts.options.play_speed
        self._speed = 1.0 if speed is None else speed

    def action_pause(self) -> None:
        """Freeze the view of a capture, or resume it; play a file, or pause playback."""
        model, viewport = self._model, self._table.viewport
        if model.state.live:
            self._table.toggle_pause()
        elif model.start_ns is None:
            self._notice.inform(_("no row here has a time"))
        elif model.playback is not None and viewport.following:
            model.playback.paused = not model.playback.paused
        else:
            self._play()

    def _play(self) -> None:
        """Play from the row under the cursor; from the first if that is the last."""
        model, index = self._model, self._table.last_index
        speed = self._speed if model.playback is None else model.playback.speed
        model.stop_playback()
        if index >= model.store.next - 1:
            index = model.store.first
        self._play_from(index, speed)

    def _play_from(self, index: int, speed: float) -> None:
        self._panes.restart(*self._model.play(index, speed, monotonic_ns()))
        self._table.action_follow()
        self._notice.inform(
            _("playing; < and > change the speed, space pauses, esc shows the whole file")
        )

    def stop(self) -> None:
        """Show the whole file again, if it is played."""
        if self._model.playback is None:
            return
        self._speed = self._model.playback.speed
        self._table.stop_following()
        events = self._model.stop_playback()
        self._panes.observe(events)
        self._table.sync()
        self._notice.report(_("the whole file is shown"))

    def action_speed(self, by: int) -> None:
        """Play faster or more slowly."""
        if self._model.playback is None:
            self._notice.inform(_("nothing is played; space plays a file from the cursor's row"))
        else:
            self._model.playback.change_speed(by)
