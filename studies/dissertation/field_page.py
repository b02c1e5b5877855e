"""The section on chapter 7 of docs/dissertation.md."""

from string import Template
from typing import Final

from studies.dissertation import field_tables
from studies.dissertation.field_tables import PLANTS, Numbers

COMMAND: Final = "uv run python -m studies.dissertation.chapter7"

SECTION = Template("""\
## Field experiments (7)

The logs of the experiments are not to be had. Here the virtual tractor drives them: both fields with the
estimates that the dissertation prints, at 4.5 m/s, 8° of the wheels, steps, chirp and random steering, three
replicates each, on the [planar and on the spatial plant](simulator.md), 36 logs
([the fields](../examples/scenarios/dissertation)). The rig of a field is one, with a load, a survey and
sensors that are not quite what the machine file says; each run has its own ground and noise. So what can be
compared is how well parameters are found and what they predict, not the soil. N1, N2 and N3 are the step runs
of the first field. Each run is fitted by itself from the machine file's values, which are those of Table 7.2,
as [`tilth fit`](operating.md) does it, and joined with others. `$command` makes the numbers.

In all tables ± is a standard deviation, C is in kN/rad and σ in m. An estimate of ours whose 95 % does not
hold what was simulated is marked "!"; bold are predictions of runs that were not fitted.

Table 7.3, with N2 of each field as ours:

$table_7_3

Table 7.4, distance from the measured path over 30 s, root mean square:

$table_7_4

Table 7.5, the first field's step runs:

$table_7_5

Table 7.6, as Table 7.4:

$table_7_6

![Paths of a run that was not fitted](figures/figure-7-4.svg)

*Figure 7.4: N3 as measured and as predicted.*

![Distances from the measured path](figures/figure-7-5.svg)

*Figure 7.5: how far the predictions of N3 are off; in print, paths.*

![Frequency responses of random steering](figures/figure-7-6.svg)

*Figure 7.6: yaw rates over the wheel angle of one random run of 30 s, at the frequencies that its steering
excites, with the 95 % band of what is measured.*

### What the print does not show

How many 95 % intervals hold what was simulated, over both fields and all manoeuvres; two and three runs are
of the same manoeuvre, nine all of a field:

$coverage

$states

Held-out predictions over all of them, median and range. In print they are 0.05 to 1.34 m by two runs, and
1.1 to 2.0 m by N2. Over 30 s nothing corrects a prediction, and uneven ground turns the rig by what nobody
measures: on the planar plant even all that is true predicts no better than the last row of it says.

$predictions
""")


def section(found: Numbers) -> str:
    """In Markdown."""
    return SECTION.substitute(
        command=COMMAND,
        table_7_3=field_tables.table_7_3(found),
        table_7_4=field_tables.table_7_4(found),
        table_7_5=field_tables.table_7_5(found),
        table_7_6=field_tables.table_7_6(found),
        coverage=field_tables.coverage_table(found),
        states=" ".join(_states(found, plant) for plant in PLANTS),
        predictions=field_tables.prediction_table(found),
    ).rstrip()


def _states(found: Numbers, plant: str) -> str:
    estimated, of = field_tables.states(found, plant)
    off, joined = field_tables.disagreeing(found, plant)
    return (
        f"On the {plant} plant {estimated} of {of} parameters of single runs are estimated, and of {joined} "
        f"sets of runs {off} do not agree by their own test."
    )
