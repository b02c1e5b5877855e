"""The words of notices in German; the rows are those of NOTICES."""

from collections.abc import Callable, Mapping
from typing import Final

from tilth.schemas.flow import FlagKind
from tilth.schemas.notices import NoticeCode

Words = str | Callable[..., str]
DAY_S: Final = 86_400.0
NAMES: Final[Mapping[str, str]] = {
    "tractor_front": "Traktor vorn", "tractor_rear": "Traktor hinten",
    "implement_front": "Gerät vorn", "implement_rear": "Gerät hinten", "wheel_angle": "Lenkwinkel",
}  # fmt: skip
_BEGUN: Final[Mapping[str, str]] = {
    FlagKind.LOST: "gibt keine brauchbare Position",
    FlagKind.WAITING: "hat noch keine Position gegeben",
    FlagKind.FLOATING: "hat den RTK-Fix verloren (Float)",
    FlagKind.NO_RTK: "hat keinen RTK-Fix",
    FlagKind.NO_FIX: "hat keinen Fix",
    FlagKind.REPEATING: "wiederholt alte Positionen",
    FlagKind.SWAPPED: "steht am Platz eines anderen: zwei Empfänger sind vertauscht",
    FlagKind.MOVED: "ist nicht, wo die Maschinendatei sagt",
    FlagKind.DOUBTFUL: "passt in diesem Augenblick nicht zum Gespann",
    FlagKind.LATE: "ist verspätet; seine Position wird fortgeschrieben",
    FlagKind.LATENCY: "meldet später, als die Maschinendatei erlaubt, oder wurde längs versetzt",
    FlagKind.SPIKES: "sendet Werte, die hin und her springen; sie entfallen: Kabel und Stecker ansehen",
    FlagKind.FIX_UNKNOWN: "meldet seinen Fix nicht mehr",
}
_STANDING: Final = {
    "velocity": "Geschwindigkeit", "yaw_rate": "Drehrate", "heading": "Richtung", "roll": "Neigung",
}  # fmt: skip


def _flag(*, flag: str, of: str, times: float = 1.0) -> str:
    if flag == FlagKind.LATE_FRAMES:
        return (
            "CAN-Botschaften kamen spät: dieser Rechner, oder der sendende, ist beschäftigt; so lange wird "
            "nichts gelernt"
        )
    silent = of == "wheel_angle" and flag != FlagKind.SPIKES
    again = f" (zum {times:.0f}. Mal)" if times > 1.0 else ""
    return f"{NAMES.get(of, of)} {'schweigt' if silent else _BEGUN[flag]}{again}"


def _stray(
    *,
    bus: str,
    frames: float,
    least_s: float,
    most_s: float,
    source: float | None = None,
    identifier: str = "",
) -> str:
    sender = f"Kennung {identifier}" if source is None else f"Adresse {source:.0f}"
    if most_s < 0:
        apart = f"{_between(-most_s, -least_s)} hinter den übrigen"
    elif least_s > 0:
        apart = f"{_between(least_s, most_s)} vor den übrigen"
    else:
        apart = f"bis {_between(0.0, -least_s)} hinter und {_between(0.0, most_s)} vor den übrigen"
    return f"{frames:.0f} Botschaften von {sender} auf {bus}: Zeitstempel {apart}; sie entfallen"


def _between(least_s: float, most_s: float) -> str:
    unit_s, unit = (DAY_S, "Tage") if most_s >= 2 * DAY_S else (1.0, "s")
    least, most = f"{least_s / unit_s:.1f}", f"{most_s / unit_s:.1f}"
    return f"{most} {unit}" if least == most or not least_s else f"{least} bis {most} {unit}"


def _bus_apart(*, bus: str, behind_s: float) -> str:
    side = "hinter der" if behind_s > 0 else "vor der"
    return (
        f"die Uhr von {bus} ist {_between(0.0, abs(behind_s))} {side} der anderen Busse: sie wird nach der "
        "Reihenfolge der Botschaften ausgerichtet"
    )


def _coarse(*, step_s: float) -> str:
    steps = "ganze Sekunden" if step_s == round(step_s) else f"Schritte von {step_s:g} s"
    return (
        f"die Zeitstempel der Aufzeichnung sind {steps}: was in einem davon kam, ist zeitlich nicht zu trennen; "
        "feiner aufzeichnen"
    )


def _stands_still(*, of: str, quantity: str, still_s: float) -> str:
    text = (
        f"{_standing(of, quantity)} steht still: {still_s:.1f} s lang derselbe Wert, während das Gespann fuhr"
    )
    if of == quantity == "wheel_angle":
        return (
            f"{text}. Bis er sich wieder bewegt, gibt es keinen Wert: Sensor, Gestänge, Stecker und Kabel "
            "ansehen"
        )
    return f"{text}. Bis dahin wird er nicht benutzt: den Sender neu starten, sein Kabel ansehen"


def _standing(of: str, quantity: str) -> str:
    if of == "wheel_angle":
        return "der Lenkwinkelsensor" if quantity == "wheel_angle" else "die Raddrehzahl"
    return f"{NAMES.get(of, of)}: {_STANDING[quantity]}"


def _clock_wrong(*, ahead_s: float) -> str:
    days = abs(ahead_s) / DAY_S
    size = f"{days:.1f} Tage" if days > 1 else f"{abs(ahead_s):.0f} s"
    side = "hinter" if ahead_s > 0 else "vor"
    return f"die Uhr des Rechners geht {size} {side} UTC; in der Aufzeichnung steht es"


_ACCEPT: Final = "Er wird nicht benutzt: so annehmen ({which}), oder zurücksetzen"

NOTICES: Final[Mapping[NoticeCode, Words]] = {
    NoticeCode.TEXT: "{text}",
    NoticeCode.REASON: "{reason}",
    NoticeCode.FLAG: _flag,
    NoticeCode.OVER: "{of}: vorbei",
    NoticeCode.SILENCE: "{silence_s:.1f} s lang keine Botschaft",
    NoticeCode.MESSAGES_MISSING: "{file}: {why}",
    NoticeCode.STEPPED_BACK: (
        "die Uhr der Aufzeichnung sprang um {by_s:.1f} s zurück; Positionen werden neu ausgerichtet"
    ),
    NoticeCode.COARSE_STAMPS: _coarse,
    NoticeCode.BUS_CLOCK_APART: _bus_apart,
    NoticeCode.BUSES_APART: (
        "nach der UTC der Empfänger geht die Uhr von {ahead} {apart_s:.1f} s vor der von {behind}: was beide sagen, "
        "gehört nicht zusammen; eine Uhr benutzen"
    ),
    NoticeCode.STRAY_FRAMES: _stray,
    NoticeCode.RECEIVER_AT: "{mount} auf Adresse {source:.0f}",
    NoticeCode.ADDRESS: "{source:.0f} auf {bus}",
    NoticeCode.ADDRESSES_KEPT: (
        "{bus} schwieg {silence_s:.0f} s: die Empfänger haben ihre alten Adressen: {parts}"
    ),
    NoticeCode.ADDRESSES_DOUBTED: (
        "die Empfänger haben vielleicht nicht ihre alten Adressen: sie werden an ihrem Ort gesucht"
    ),
    NoticeCode.ADDRESSES_CONFIRMED: (
        "die Empfänger haben die Adressen von vorher, wie Positionen auf {travel:.1f} m Weg zeigen: {parts}"
    ),
    NoticeCode.ADDRESSES_CHANGED: (
        "die Empfänger haben andere Adressen als vorher, wie Positionen auf {travel:.1f} m Weg zeigen: {parts}"
    ),
    NoticeCode.ADDRESSES_UNREADABLE: (
        "wer in früheren Fahrten welche Adresse hatte, ist nicht bekannt: {file} ist unbrauchbar ({error})"
    ),
    NoticeCode.RECOGNISED: (
        "keine Anmeldung sagt, wer wer ist: die Empfänger werden auf {travel:.1f} m Weg an ihrem Ort erkannt: "
        "{parts}"
    ),
    NoticeCode.NONE_FITS: (
        "weder Anmeldungen noch Positionen der Adressen {parts} sagen, wer sie sind: keine Zuordnung passt zum "
        "Gespann; in der Maschinendatei mit source angeben, oder aus- und einschalten"
    ),
    NoticeCode.SEVERAL_FIT: (
        "weder Anmeldungen noch Positionen der Adressen {parts} sagen, wer sie sind: mehrere Zuordnungen passen "
        "zum Gespann; in der Maschinendatei mit source angeben, oder aus- und einschalten"
    ),
    NoticeCode.TWIN_NAME: (
        "zwei Geräte melden den NAME {name} (Adressen {source:.0f} und {other:.0f} auf {bus}): er benennt keines; "
        "in der Maschinendatei mit source angeben"
    ),
    NoticeCode.POSITIONS_REPEATED: (
        "{of} sendet jede Position {times:.0f}-mal: {per_s:.1f} in der Sekunde sind neu, die übrigen entfallen; "
        "seine Ausgabe auf die Rate seiner Positionen stellen"
    ),
    NoticeCode.POSITIONS_SLOW: "{of} gibt nur {per_s:.1f} Positionen in der Sekunde; auf 5 oder mehr stellen",
    NoticeCode.STANDS_STILL: _stands_still,
    NoticeCode.MOVES_AGAIN: lambda *, of, quantity: f"{_standing(of, quantity)} bewegt sich wieder",
    NoticeCode.NOT_HEARD: "nicht gehört: {mounts}",
    NoticeCode.NO_WHEEL_ANGLE: "nicht gehört: der Lenkwinkel",
    NoticeCode.WITHOUT_RTK: "ohne RTK-Fix: {mounts}",
    NoticeCode.CONTRADICTED: "{ended}{hitched} Bis das vorbei ist, gibt es keinen Wert",
    NoticeCode.FITS_AGAIN: "{key}: vorbei; die Daten passen wieder zur Maschinendatei",
    NoticeCode.MOVED: "{reason}; vor {ago_min:.0f} min. " + _ACCEPT,
    NoticeCode.MOVED_EARLIER: "eine frühere Fahrt fand: {reason}. " + _ACCEPT,
    NoticeCode.MOVED_BACK: "{what} ist wieder am alten Platz und wird wieder benutzt",
    NoticeCode.TYRES_CHANGED: "{reason}. Keine Schätzung benutzt ihn; so annehmen ({which})",
    NoticeCode.TYRES_BACK: "der Radius der Reifen ist wieder der alte: {key}",
    NoticeCode.ACCEPTED: "angenommen: {reason}; für die Maschinendatei: {line}",
    NoticeCode.LOAD_TOLD: "das Gerät trägt {carried}; gesagt von: {source}",
    NoticeCode.LOAD_CHANGED: (
        "das Gerät trägt mehr oder weniger als vorher: seine Reifen halten anders, bezogen auf seine Masse, die "
        "des Traktors wie vorher. C_ai hat wieder einen Wert, wenn jemand die Ladung sagt, etwa mit "
        "`tilth implement --load full`"
    ),
    NoticeCode.LOAD_OR_SOIL: (
        "das Gerät trägt mehr oder weniger als vorher, oder der Boden hält die Reifen anders: das Fahren sagt "
        "nicht, was. Die Ladung sagen, etwa mit `tilth implement --load full`"
    ),
    NoticeCode.SOIL_CHANGED: "der Boden hält die Reifen anders{listed}: was vorher gelernt wurde, ist aufgegeben",
    NoticeCode.SOIL_CHANGING: (
        "der Boden hält die Reifen anders: was vorher gelernt wurde, ist aufgegeben; um wie viel, zeigt die "
        "weitere Fahrt"
    ),
    NoticeCode.STIFFNESSES_ANEW: (
        "die Messwerte passen nicht mehr zu dem, was {turning_s:.0f} s Kurvenfahrt lehrten: die Steifigkeiten "
        "werden neu gelernt"
    ),
    NoticeCode.FACTOR: "{parameter} × {low:.2f} bis {high:.2f}",
    NoticeCode.STORED_STATE_REFUSED: "{file}: der gespeicherte Stand wird nicht benutzt: {why}; es geht ohne ihn weiter",
    NoticeCode.ACCEPTED_EARLIER: (
        "{what} ist, wie in einer früheren Fahrt angenommen, nicht wie in der Maschinendatei"
    ),
    NoticeCode.BUS_BACK: (
        "{bus}: geht nach {down_s:.1f} s wieder (Ausfall {failure:.0f}, Öffnen {opening:.0f})"
    ),
    NoticeCode.BUS_FAILED: (
        "{bus}: {why}; wird wieder versucht (Ausfall {failure:.0f}, {frames:.0f} Botschaften bis dahin)"
    ),
    NoticeCode.BUS_HEARD: "{bus}: nach {silence_s:.1f} s wieder gehört (Schweigen {silence:.0f})",
    NoticeCode.BUS_LOST_FRAMES: "{bus}: {frames:.0f} {what} ({in_all:.0f} insgesamt)",
    NoticeCode.BUS_SILENT: (
        "{bus}: schweigt, {silence_s:.1f} s lang keine Botschaft (Schweigen {silence:.0f}), {frames:.0f} bis dahin"
    ),
    NoticeCode.BUS_STAMPED: "{bus}: die Zeit seiner Botschaften kommt von {by}",
    NoticeCode.BUS_TROUBLE: "{bus}: {why}",
    NoticeCode.CACHE_REFUSED: "{why}",
    NoticeCode.CLOCK_SET: (
        "die Uhr des Rechners wurde um {by_s:+.3f} s gestellt; die der Aufzeichnung läuft gleichmäßig weiter"
    ),
    NoticeCode.CLOCK_WRONG: _clock_wrong,
    NoticeCode.COMPILER_FAILED: (
        "das Übersetzen ist ausgefallen ({why}); es geschieht neben der Aufzeichnung, die Botschaften so lange "
        "später nimmt"
    ),
    NoticeCode.COMPILES_AT_OWN_PRIORITY: "übersetzt wird mit dem Vorrang der Aufzeichnung: {why}",
    NoticeCode.COMPILING: (
        "der Rechenteil wird übersetzt, einmal je Rechner: aufgezeichnet wird schon, Werte folgen"
    ),
    NoticeCode.COMPILING_ANEW: (
        "der Rechenteil wird übersetzt und kann hier nicht behalten werden: aufgezeichnet wird schon, Werte folgen"
    ),
    NoticeCode.DELETED: "{run} wurde gelöscht, um Platz zu schaffen: {megabytes:.0f} MB",
    NoticeCode.DISK_SILENT: "{folder}: das Laufwerk antwortet nicht; das Ende der Aufzeichnung fehlt vielleicht",
    NoticeCode.DISK_TROUBLE: "{why}",
    NoticeCode.END_MISSING: "das Ende der Aufzeichnung fehlt vielleicht: {why}",
    NoticeCode.FINISHED: "{file} war unfertig; jetzt fertig: {messages:.0f} Botschaften",
    NoticeCode.FITS_AT_OWN_PRIORITY: "ausgewertet wird mit dem Vorrang der Aufzeichnung: {why}",
    NoticeCode.FIT_FAILED: "eine Auswertung von {method} ist ausgefallen: {why}",
    NoticeCode.IMPLEMENT_ASSUMED: (
        "niemand hat gesagt, welches von {all} angehängt ist: {implement} wird angenommen; auf der Seite oder "
        "mit `tilth implement NAME` wählen"
    ),
    NoticeCode.IMPLEMENT_CHANGED: "{implement} ist angehängt: eine neue Fahrt beginnt",
    NoticeCode.IMPLEMENT_HEARD: (
        "ein Steuergerät von {implement} meldet sich (NAME {device}), keines des vorigen Geräts: {implement} "
        "ist angehängt, eine neue Fahrt beginnt"
    ),
    NoticeCode.IMPLEMENT_LENGTHS: (
        "die Fahrt zeigt von {implement}: Kupplung bis Achse {drawbar}, Kupplung bis Mitte der Empfänger "
        "{receivers}. Damit wird weitergerechnet, die Schätzung beginnt neu. Genauer wird sie mit dem "
        "Maßband von der Kupplung bis zur Achse und der Masse von der Waage"
    ),
    NoticeCode.IMPLEMENT_STRANGE: (
        "{device} (NAME {name}) meldet sich und steht in der Datei keines Geräts; die Werte sind die von "
        '{implement}. Ist es dieses, names = ["{name}"] in [implement] seiner Datei schreiben. Sonst braucht '
        "es eine Datei: Masse, Spurweite, Deichsel bis Achse und Plätze der Empfänger messen; `tilth calibrate` "
        "findet die Längen beim Fahren"
    ),
    NoticeCode.IMPLEMENT_UNDESCRIBED: (
        "{device} (NAME {name}) meldet sich, steht in der Datei keines Geräts, und von {implement} "
        "meldet sich nichts: eine Fahrt mit einem unbeschriebenen Gerät beginnt. Zuerst zeigt die Fahrt "
        "seine Längen: stehen, dann zu beiden Seiten wenden, mit zwei Geschwindigkeiten. Es braucht eine "
        'Datei: Masse, Spurweite, Kupplung bis Achse und Plätze der Empfänger messen, names = ["{name}"] '
        "in sein [implement] schreiben"
    ),
    NoticeCode.KERNELS_COMPILED: (
        "der Rechenteil wurde in {compiling_s:.0f} s übersetzt, während aufgezeichnet wurde; die Schätzung beginnt"
    ),
    NoticeCode.KERNELS_REFUSED: "der Rechenteil war nicht vorzubereiten ({why}); Werte kommen vielleicht spät",
    NoticeCode.LEARNED_REFUSED: "was frühere Fahrten lernten, wird nicht benutzt: {why}",
    NoticeCode.METHOD_REFUSED: "was {method} in früheren Fahrten lernte, wird nicht benutzt: {reason}",
    NoticeCode.NEW_RUN: "Zündung an: eine neue Fahrt beginnt in {file}",
    NoticeCode.NOT_PUBLISHED: "nichts wird veröffentlicht: {why}; [zenoh] in der Maschinendatei berichtigen",
    NoticeCode.NOT_RECORDING: "zeichnet nicht auf: {why}",
    NoticeCode.NO_REPORT: "kein Bericht der Fahrt bis hier: {why}",
    NoticeCode.RECORDING_AGAIN: "zeichnet wieder auf in {file}; {missed:.0f} Botschaften fehlen",
    NoticeCode.REPORT_AT_OWN_PRIORITY: "der Bericht entsteht mit dem Vorrang der Aufzeichnung: {why}",
    NoticeCode.REPORT_MADE: "Bericht der Fahrt bis hier: {file}",
    NoticeCode.RESUMED: "{methods} gehen von dem aus, was bis vor {hours:.1f} h gelernt wurde",
    NoticeCode.FIELD_MAP: "place und tracker gehen von der Karte des Feldes aus, das zuletzt vor {hours:.1f} h befahren wurde",
    NoticeCode.UNFINISHED: "{file} war unfertig und bleibt es: {why}",
    NoticeCode.UNLOCKED: (
        "{folder}: dieses Dateisystem kennt keine Sperren; aufgezeichnet wird trotzdem, aber kein anderes Programm "
        "weiß sicher, dass eine Datei geschrieben wird: dort so lange kein `tilth recover` benutzen"
    ),
    NoticeCode.UPDATED: "von {before} auf {version} aktualisiert; es wird aufgezeichnet",
    NoticeCode.UPDATE_READY: (
        "{file} ist installiert und wartet: {version} läuft ab dem nächsten Ausschalten der Zündung oder Start. Der "
        "Stick wird nicht mehr gebraucht"
    ),
    NoticeCode.UPDATE_CRASHED: (
        "die Aktualisierung auf {version} wurde zurückgenommen, {before} läuft wieder: sie endete {times:.0f}-mal in "
        "den ersten Minuten; {version} wird nicht noch einmal versucht"
    ),
    NoticeCode.UPDATE_NOT_RECORDING: (
        "die Aktualisierung auf {version} wurde zurückgenommen, {before} läuft wieder: sie hat in {within_s:.0f} s "
        "nichts aufgezeichnet; {version} wird nicht noch einmal versucht"
    ),
    NoticeCode.UPDATE_OTHER_PROCESSOR: (
        "keine Aktualisierung: {file} ist für andere Prozessoren; dieser Rechner nimmt {here}"
    ),
    NoticeCode.UPDATE_SEVERAL: "keine Aktualisierung: mehrere Pakete, {files}; nur eines dort lassen",
    NoticeCode.UPDATE_UNSIGNED: (
        "keine Aktualisierung: bei {file} liegt keine Unterschrift, die sich lesen lässt ({signature})"
    ),
    NoticeCode.UPDATE_UNKNOWN_KEY: (
        "keine Aktualisierung: {file} ist von {key} unterschrieben, das dieser Rechner nicht kennt; seine Schlüssel "
        "sind in {folder}"
    ),
    NoticeCode.UPDATE_REVOKED_KEY: (
        "keine Aktualisierung: {file} ist von {key} unterschrieben, das widerrufen wurde; ein neu unterschriebenes "
        "Paket nehmen"
    ),
    NoticeCode.UPDATE_FORGED: (
        "keine Aktualisierung: {file} ist nicht, was {key} unterschrieben hat; Paket und Unterschrift neu kopieren, "
        "von dort, wo sie herkommen"
    ),
    NoticeCode.UPDATE_OLDER: (
        "keine Aktualisierung: {file} ist älter als {newest}, das dieser Rechner schon hatte; von Hand nimmt es "
        "`tilth-setup upgrade`"
    ),
    NoticeCode.UPDATE_NO_ROOM: (
        "keine Aktualisierung: {file} braucht {needed_mb:.0f} MB auf der Platte, {free_mb:.0f} MB sind frei; Platz "
        "schaffen"
    ),
    NoticeCode.UPDATE_UNREADABLE: "keine Aktualisierung: {file} ließ sich nicht lesen: {why}",
    NoticeCode.UPDATE_REFUSED: "keine Aktualisierung: {file} ließ sich nicht installieren: {why}",
    NoticeCode.BACKWARDS: "der Traktor fährt rückwärts",
    NoticeCode.BEYOND_BRAKING: "mit {braking:.1f} m/s² gebremst",
    NoticeCode.BEYOND_LATERAL: "{acceleration:.1f} m/s² zur Seite; der Plan erlaubt {limit:g}",
    NoticeCode.BEYOND_WHEELS: "die Räder stehen auf {wheels_deg:.0f}°; der Plan erlaubt {limit_deg:g}°",
    NoticeCode.BY_THE_DRIVER: "durch den Fahrer",
    NoticeCode.END_NOT_CONFIRMED: "die Marke am Ende ist nicht bestätigt",
    NoticeCode.END_REFUSED: "das Ende ist nicht aufgezeichnet: {why}",
    NoticeCode.FIELD_ENDS: "hier endet das Feld",
    NoticeCode.FOLLOWED_LITTLE: "die Räder folgten nur {share:.0%} des Balkens",
    NoticeCode.NOT_WITH_THE_BAR: "die Räder gingen nicht mit dem Balken: {left:.0%} davon bleiben übrig",
    NoticeCode.NO_POSE_FOR: "seit {silence_s:.1f} s keine Lage",
    NoticeCode.OFF_THE_BAR: "die Räder waren {off_s:.1f} s lang {off_deg:.0f}° neben dem Balken",
    NoticeCode.POSE_UNKNOWN: "die Lage des Traktors ist nicht bekannt",
    NoticeCode.PROMPTER_ENDED: "die Anleitung wurde beendet",
    NoticeCode.PROMPTER_ENDED_EARLY: "die Anleitung wurde beendet, bevor die Marke am Ende bestätigt war",
    NoticeCode.RECEIVERS_LOST: "Empfänger sind verloren oder passen nicht: {mounts}",
    NoticeCode.RTK_LOST: "RTK verloren an {mounts}",
    NoticeCode.START_NOT_CONFIRMED: "die Marke am Anfang ist nicht bestätigt",
    NoticeCode.START_REFUSED: "der Anfang ist nicht aufgezeichnet: {why}",
    NoticeCode.STOPPED: "vom Fahrer angehalten",
    NoticeCode.TOO_FAST: "{speed_kmh:.1f} km/h, gefahren wird mit {wanted_kmh:.1f}",
    NoticeCode.TOO_SLOW: "nur {speed_kmh:.1f} km/h, gefahren wird mit {wanted_kmh:.1f}",
    NoticeCode.WHEELS_NOT_HEARD: "der Lenkwinkel wird nicht gehört",
}
