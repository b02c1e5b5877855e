"""The words of reasons, diagnoses, advice and soil in German; each table has the rows of its English one."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from tilth.schemas.reasons import Code
from tilth.schemas.sentences.diagnosis import DEGREES, LARGEST, measured
from tilth.schemas.spread import interval, plus_minus

GERMAN: Final = "de"  # key of the tables of words

METHODS: Final[Mapping[str, str]] = {
    "pem": "Auswertung ganzer Manöver", "tracker": "laufende Schätzung",
    "steady_state": "gleichmäßige Kurven", "rows": "gerade Bahnen", "place": "Gedächtnis der Orte",
}  # fmt: skip

SENTENCES: Final[Mapping[Code, str]] = {
    Code.TEXT: "{of[0]}",
    Code.SETTLING: "schwingt ein",
    Code.REVERSE: "Rückwärtsfahrt",
    Code.TOO_SLOW: "zu langsam",
    Code.BEYOND_WHEEL_ANGLE: "Räder weiter eingeschlagen, als eine Lenkung es kann",
    Code.BEYOND_ARTICULATION: "weiter geknickt als in einer Wende mit vollem Einschlag",
    Code.POSE_GAP: "Lücke in den Lagen",
    Code.NEW_ORIGIN: "neuer Nullpunkt der Ebene",
    Code.NO_WHEEL_ANGLE: "kein Lenkwinkel",
    Code.RECEIVERS_MISPLACED: "die Empfänger passen nicht zum Gespann",
    Code.NO_RTK: "kein RTK-Fix",
    Code.NO_ROLL: "Neigung nicht gemessen",
    Code.NO_HEADING: "keine Richtung",
    Code.POSE_INCOMPLETE: "Lage unvollständig",
    Code.RECEIVER_LATE: "Empfänger verspätet",
    Code.FRAMES_LATE: "CAN-Botschaften kamen spät",
    Code.WHEEL_ANGLE_STANDS: (
        "der Lenkwinkelsensor steht still, während das Gespann dreht: Sensor, Gestänge, Stecker oder Kabel"
    ),
    Code.HEADING_NOT_OF_PAIR: "Richtung nicht aus zwei Empfängern",
    Code.TURNING_IN_OR_OUT: "Ein- oder Auslenken",
    Code.SPEED_NOT_STEADY: "Geschwindigkeit nicht gleichmäßig",
    Code.TOO_LITTLE_STEERING: "zu wenig gelenkt",
    Code.HELD: "die Räder stehen auf einem Winkel: nach beiden Seiten lenken",
    Code.NOT_STRAIGHT: "keine gerade Bahn",
    Code.LITTLE_OWN_STEERING: (
        "in den Bahnen antwortet die Lenkung nur dem Boden und tut von sich aus fast nichts: ein Zittern von"
        " 0,3 Grad würde helfen"
    ),
    Code.TOO_SHORT: "zu kurze Zeit ohne Lücke",
    Code.FIT_OVERTAKEN: "die Auswertung davor kam zu spät",
    Code.CONTRADICTED: "die Daten widersprechen der Maschinendatei",
    Code.INPUTS_NOT_FINITE: "die Eingaben sind keine Zahlen",
    Code.RESULT_NOT_FINITE: "das Ergebnis ist keine Zahl",
    Code.FILTER_SETTLING: "die Schätzung schwingt ein",
    Code.FILTER_OUT_OF_BOUNDS: "die Schätzung hat ihre Grenzen verlassen",
    Code.MOST_SAMPLES_REJECTED: "die meisten Messungen werden verworfen",
    Code.OUTLIER: "Ausreißer",
    Code.SLIP_BEYOND_MODEL: "mehr Schräglauf, als das Reifenmodell kann",
    Code.NO_STEADY_TURN_EXISTS: "bei diesen Steifigkeiten gibt es keine gleichmäßige Kurve",
    Code.NOT_CONVERGED: "die Auswertung fand kein Ende",
    Code.BEYOND_TYRES: "das Ergebnis kann kein Reifen sein",
    Code.TWO_PLACES: "zweierlei Reifen erklären diese Fahrt etwa gleich gut: auch anders lenken",
    Code.OUTPUTS_NOT_MEASURED: "Drehraten oder Richtungen beider Fahrzeuge sind nicht gemessen",
    Code.NO_STEADY_TURN: "keine gleichmäßige Kurve in dieser Fahrt",
    Code.END_OF_SEARCH: "ein Wert lief ans Ende seines Suchbereichs",
    Code.FIT_LATE: (
        "eine Auswertung kam {n[0]:.1f} s zu spät, weil dieser Rechner beschäftigt ist; sie gilt ab hier"
    ),
    Code.FIT_DROPPED: "eine Auswertung war nicht rechtzeitig fertig und entfällt",
    Code.FIT_GIVEN_UP: "eine Auswertung war {n[0]:.0f} s nach ihrer Zeit nicht fertig und wird aufgegeben",
    Code.NOTHING_LEARNED: "noch nichts gelernt",
    Code.NOTHING_FITTED: "noch keine Fahrt mit Lenken ausgewertet",
    Code.NO_ROWS_YET: "noch keine zwei Minuten gerader Bahnen ausgewertet",
    Code.NO_STEADY_TURN_YET: "noch keine gleichmäßige Kurve",
    Code.NO_WINDOW_YET: "noch kein Abschnitt ausgewertet",
    Code.WIDE: "die Daten lassen {n[0]:share} offen: mehr lenken",
    Code.OF_THE_MASS: (
        "die Maschinendatei kennt {of[0]} nur auf {n[0]:share}: wiegen; je Kilogramm ist die Steifigkeit"
        " bekannt, {n[1]:share}"
    ),
    Code.NOT_LEARNED_FOR: "seit {n[0]:.0f} s nichts gelernt",
    Code.NO_SOUND_DATA_FOR: "seit {n[0]:.0f} s keine brauchbaren Daten",
    Code.NO_STEADY_DRIVING_FOR: "seit {n[0]:.0f} s keine gleichmäßige Fahrt",
    Code.RANK: "Rang {n[0]:.0f} von 3: mehr gleichmäßige Kurven nach beiden Seiten fahren",
    Code.RANK_WITHOUT_SIDESLIP: (
        "Rang {n[0]:.0f} von 3: ohne Schwimmwinkel sind drei Steifigkeiten nicht zu trennen"
    ),
    Code.RANK_OF_TWO_OUTPUTS: (
        "Rang {n[0]:.0f} von 3: Drehrate und Knickwinkel trennen drei Steifigkeiten nicht"
    ),
    Code.NO_RELAXATION: "gleichmäßige Fahrt sagt nichts über Einlauflängen",
    Code.ON_UNIDENTIFIABLE: (
        "steht auf Steifigkeiten, die zwei Messgrößen nicht trennen; mit freier Verstärkung ist das"
        " Intervall zu eng"
    ),
    Code.NOT_CONFIRMED: (
        "die Fahrt hat noch nicht gezeigt, dass die Maschinendatei stimmt{keys}: bei Arbeitsgeschwindigkeit"
        "{seconds} hin und her lenken"
    ),
    Code.NOT_DRIVEN: "noch nichts gefahren",
    Code.DOUBTED: (
        "die Fahrt passt nicht gut zur Maschinendatei ({of[0]}?): prüfen, oder weiterfahren und bei"
        " Arbeitsgeschwindigkeit hin und her lenken"
    ),
    Code.NOT_EXCLUDED: (
        "die Fahrt hat einen Fehler von {of[0]} in der Maschinendatei nicht ausgeschlossen, das lässt"
        " {n[0]:share} offen: bei Arbeitsgeschwindigkeit {n[1]:.0f} s lang um 3° oder mehr hin und her lenken"
    ),
    Code.WIDENED: "{n[0]:share} davon sind Raum für einen Fehler von {of[0]} in der Maschinendatei",
    Code.OTHER_SOIL: "der Boden kann hier anders sein, als wo dies gelernt wurde: {n[0]:share}",
    Code.NOT_KNOWN_HERE: "der Boden kann hier anders sein, als wo gelernt wurde, das lässt {n[0]:share} offen",
    Code.FIRST_WITH_NUMBERS: "{of[0]}: zuerst genannt von {others}, was Werte gibt",
    Code.FIRST_THOUGH_OLD: "{of[0]}: zuerst genannt von {others}, was Werte gibt, wenn auch alte",
    Code.SOIL_CHANGED_SINCE: (
        "{of[0]}: der Boden wurde vor {n[0]:.0f} s anders, nach dem letzten ausgewerteten Abschnitt"
    ),
    Code.WINDOW_OLD: "{of[0]}: der letzte ausgewertete Abschnitt ist {n[0]:.0f} s alt",
    Code.NO_WINDOW: "{of[0]}: der nächste Abschnitt ist noch nicht gefahren",
    Code.CLAIMS_LESS: "{of[0]}: die Verfahren widersprechen sich, und dieses behauptet weniger als {others_and}",
    Code.IN_PATCHES: "{of[0]}: der Boden ist hier von Ort zu Ort anders, und dies gilt, wo das Gespann ist",
    Code.KNOWS_MORE: "{of[0]}: nutzt mehr von der Fahrt als {others_and}, dem es widerspricht",
    Code.ROWS_KNOW_MORE: "{of[0]}: kennt die Werte im Mittel auf {n[0]:share}, {of[1]} auf {n[1]:share}",
    Code.ROWS_ALONE: "{of[0]}: kein Verfahren, das aus Kurven lernt, hat Werte",
    Code.NO_METHOD: "kein Verfahren gibt einen Wert",
    Code.DISAGREE: (
        "{of[0]} und {of[1]} widersprechen sich: quadratischer Abstand {n[0]:.0f} über {n[1]:.0f} Werte,"
        " Zufall erlaubt {n[2]:.0f}"
    ),
    Code.SAVED_BY_ANOTHER_VERSION: "von einer anderen Version",
    Code.SAVED_NOT_FINITE: "darin steht, was keine Zahl ist",
    Code.SAVED_WITHOUT_COVARIANCE: "die Kovarianz darin ist keine",
    Code.SAVED_INCOMPLETE: "ein Teil davon fehlt",
    Code.ESTIMATORS_FAILED: (
        "die Schätzer sind ausgefallen ({of[0]}: {of[1]}) und beginnen neu; aufgezeichnet wird weiter"
    ),
}

_PARKED: Final[Mapping[str, str]] = {
    "longer_t": "Länge des Empfängerpaars am Traktor", "longer_i": "Länge des Empfängerpaars am Gerät",
    "c": "Kupplung, längs", "aside_i": "Kupplung, quer",
}  # fmt: skip
_FOUND: Final[Mapping[str, tuple[str, str]]] = {
    "wheel_zero": ("den Nullpunkt der Räder um {} daneben", "°"),
    "pair_t": ("das Paar am Traktor um {} verdreht", "°"),
    "pair_i": ("das Paar am Gerät um {} verdreht", "°"),
    "latency": ("eine Verspätung von {} über die der Datei hinaus", "s"),
    "aside_i": ("die Empfänger des Geräts um {} daneben", "m"), "e": ("die Achse des Geräts um {} daneben", "m"),
}  # fmt: skip
_BODY: Final[Mapping[str, str]] = {"tractor": "Traktor", "implement": "Gerät"}
Words = Callable[[Sequence[str], Sequence[float]], str]


def _how_far(key: str, number: str, n: Sequence[float]) -> str:
    if number in _FOUND:
        words, unit = _FOUND[number]
        return words.format(measured(n, 0, unit))
    low, high = interval(math.exp(min(n[0], LARGEST)), min(n[1], LARGEST))
    what = "den gelesenen Lenkwinkel" if number == "wheel_gain" else key.partition(" or ")[0]
    return f"{what} beim {low:.2f}- bis {high:.2f}-fachen der Datei (95 %)"


def _wheel_scale(of: Sequence[str], n: Sequence[float]) -> str:
    larger = max(n[0], 1.0 / max(n[0], 1e-3))
    size = f"das {n[0]:.2g}-fache" if n[0] >= 1.0 else f"1/{larger:.2g}"
    text = f"der Lenkwinkel ist {size} dessen, was die Drehrate verlangt: {of[0]}?"
    return f"{text} (Grad je Bit, nicht Radiant)" if DEGREES[0] < larger < DEGREES[1] else text


def _off(words: Words) -> Words:
    return lambda of, n: f"die Fahrt findet {words(of, n)}: {', oder '.join([of[0], *of[2:]])}?"


def _or_else(words: Words) -> Words:
    return lambda of, n: ", oder es ist ".join([words(of, n), *of[2:]])


def _tyres(of: Sequence[str], n: Sequence[float]) -> str:
    now, before, sd_now, sd_before = n[:4]
    share = 100.0 * math.hypot(sd_now / now, sd_before / before)
    return (
        f"der Radius der Reifen ist um {plus_minus(100.0 * (before / now - 1.0), share, '%')} anders: {of[0]}"
    )


def _leans(value: str) -> Words:
    return lambda of, n: (
        f"{of[1]}: bewegt sich mit der Neigung um {measured(n, 0)} seiner Höhe: roll_corrected = {value} in die "
        "Maschinendatei schreiben"
    )


DIAGNOSES: Final[Mapping[Code, Words]] = {
    Code.RECEIVER_NOT_THERE: lambda of, n: (
        f"{of[1]} ist nicht, wo die Maschinendatei sagt: sein Ort, oder die Längen bis zur Kupplung?"
    ),
    Code.RECEIVER_EXCHANGED: lambda of, n: (
        f"{of[1]} steht am Platz eines anderen: NAMEs oder Adressen vertauscht?"
    ),
    Code.RECEIVER_AT_ANOTHER_TIME: lambda of, n: (
        f"{of[1]} meldet zu einer anderen Zeit, als die Datei erlaubt: seine Verspätung oder sein Ort?"
    ),
    Code.OFF_WHERE_PARKED: lambda of, n: (
        f"{_PARKED.get(of[1], of[1])} ist im Stand um {n[0]:+.2f} m daneben: {of[0]}?"
    ),
    Code.NO_LIKELY_LATENCY: lambda of, n: (
        f"die Abstände der Empfänger passen zu keiner wahrscheinlichen Verspätung: {of[0]}?"
    ),
    Code.WHEEL_MOVES_ALONE: lambda of, n: f"der Lenkwinkel bewegt sich, der Traktor dreht nicht: {of[0]}?",
    Code.WHEEL_OPPOSITE: lambda of, n: (
        f"der Lenkwinkel antwortet der Drehrate mit umgekehrtem Vorzeichen: {of[0]}?"
    ),
    Code.WHEEL_SCALE: _wheel_scale,
    Code.WHEEL_UNRELATED: lambda of, n: (
        f"der Lenkwinkel hat nichts mit der Drehrate zu tun: {of[0]} (id, Bytes, delay)?"
    ),
    Code.FARTHER_THAN_SPEED: lambda of, n: (
        f"{_BODY.get(of[1], of[1])} fährt {n[0]:.2f}-mal so weit, wie seine Empfänger an Geschwindigkeit melden: "
        f"{of[0]}?"
    ),
    Code.ROLL_FOLLOWS_TURNS: lambda of, n: (
        f"{_BODY.get(of[1], of[1])}: die gemessene Neigung folgt den Kurven mit {math.degrees(n[0]):+.1f}° je m/s² "
        f"Querbeschleunigung, so neigt sich kein Fahrzeug: {of[0]}?"
    ),
    Code.LEAN_APART: lambda of, n: (
        f"Traktor und Gerät sind auf demselben Boden im Mittel um {math.degrees(n[0]):+.0f}° verschieden "
        f"geneigt: {of[0]}?"
    ),
    Code.CORRECTED_TWICE: _leans("true"),
    Code.NOT_CORRECTED: _leans("false"),
    Code.ROLL_CORRECTION_UNCLEAR: lambda of, n: (
        "die Kupplung bewegt sich mit der Neigung, als wäre roll_corrected am Traktor oder am Gerät falsch: "
        "mit der Einstellung der Empfänger vergleichen"
    ),
    Code.YAW_RATE_SMOOTHED: lambda of, n: (
        f"{of[1]}: seine Drehrate kommt {measured(n, 0, 's')} zu spät und wird nicht benutzt; was mit ihr gelernt "
        "wurde, ist vergessen: Glättung ausschalten"
    ),
    Code.DRIVING_FINDS: lambda of, n: (
        f"die Fahrt findet {_how_far(of[0], of[1], n)}: {of[0]}{''.join(f', oder {key}' for key in of[2:])}?"
    ),
    Code.METHOD_FINDS: lambda of, n: (
        f"{METHODS.get(of[2], of[2])} findet {_how_far(of[0], of[1], n)}: {of[0]}?"
    ),
    Code.RECEIVER_OFF: _off(
        lambda of, n: (
            f"{of[1]} {measured(n, 0, 'm')} vor und {measured(n, 1, 'm')} rechts von seinem Ort in der Datei"
        )
    ),
    Code.DRAWBAR_OFF: _off(
        lambda of, n: (
            f"die Empfänger des Geräts {plus_minus(-n[0], n[1], 'm')} weiter hinter der Kupplung als in "
            "der Datei"
        )
    ),
    Code.MOST_REJECTED: lambda of, n: (
        f"{100 * n[0]:.0f} % dessen, was die Empfänger melden, passt zu keinem solchen Gespann: Empfänger, Traktor "
        "oder Gerät?"
    ),
    Code.NO_TYRE: lambda of, n: (
        f"eine Steifigkeit vom {n[0]:.2g}-fachen der Last je rad hat kein Reifen ({of[1]}): {of[0]}?"
    ),
    Code.RECEIVER_MOVED: _or_else(
        lambda of, n: (
            f"{of[1]} wurde um {measured(n, 0, 'm')} nach vorn und {measured(n, 1, 'm')} nach rechts versetzt"
        )
    ),
    Code.PAIR_TURNED: _or_else(
        lambda of, n: (
            f"das Paar am {_BODY.get(of[1].removeprefix('pair_'), of[1])} wurde um {measured(n, 0, '°')} verdreht"
        )
    ),
    Code.WHEEL_SLIPPED: _or_else(
        lambda of, n: f"der Lenkwinkelsensor hat sich um {measured(n, 0, '°')} verschoben: {of[0]}"
    ),
    Code.DRAWBAR_CHANGED: _or_else(
        lambda of, n: f"die Deichsel ist {plus_minus(-n[0], n[len(n) // 2], 'm')} länger: {of[0]}"
    ),
    Code.TYRES_CHANGED: _tyres,
}

SOIL: Final[Mapping[str, str]] = {
    "soft": "weich", "as usual": "wie üblich", "firm": "fest",
    "between soft and usual": "zwischen weich und üblich", "between usual and firm": "zwischen üblich und fest",
    "known roughly": "nur grob bekannt", "not known yet": "noch nicht bekannt",
    "not known now": "jetzt nicht bekannt", "withdrawn": "zurückgezogen",
}  # fmt: skip

DRIVEN: Final[Mapping[str, str]] = {
    "step": "eine Kurve {seconds:g} s lang halten, Räder auf etwa {degrees:g}°",
    "steps": "{seconds:g} s lang je drei Sekunden nach der einen und der anderen Seite lenken, Räder auf etwa "
    "{degrees:g}°",
    "chirp": "{seconds:g} s lang sanft links und rechts lenken, langsam, dann schneller, Räder bis etwa "
    "{degrees:g}°",
    "turn": "am Vorgewende mit {degrees:g}° oder mehr wenden",
}
"""Of sentences.MANOEUVRES, the instruction to a driver."""
