"""What one engine adds to the published model, as C: magnitudes over time, laws, corrections, faults of sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from dieseltwin.codegen.traced import law_text
from dieseltwin.codegen.transpile import Equation, Translation, number
from dieseltwin.engine.courses import growing_s
from dieseltwin.engine.effect import Entry
from dieseltwin.engine.effects import ACTUATION_EFFECTS, EFFECTS, STATE_EFFECTS
from dieseltwin.engine.limited import Limited
from dieseltwin.engine.map_corrections import GRIDS, corrections_of, variable_of
from dieseltwin.engine.quantities import MapArguments, OperatingPoint
from dieseltwin.engine.sensor_effects import slot_parts
from dieseltwin.engine.terms import (
    SENSOR_SLOTS,
    EffectTerm,
    LawTerm,
    OneTerm,
    Term,
    corrections_in,
    effect_terms,
    law_terms,
)

WHEN = "double t, Inputs begin, Inputs end"
"""Arguments of every function that says where terms act: an interval between samples from t on [s since the start]."""

_COMMANDS = {
    "egr_stuck": Entry("command", "egr", "stuck"), "vgt_stuck": Entry("command", "vgt", "stuck"),
    "egr_play": Entry("command", "egr", "play"), "egr_more": Entry("command", "egr", "dead_time"),
    "vgt_play": Entry("command", "vgt", "play"), "vgt_more": Entry("command", "vgt", "dead_time"),
    "u_delta_lag": Entry("input", "u_delta", "lag"),
}  # fmt: skip
ACTUATORS = ("egr_stuck", "egr_play", "egr_more", "egr_share", "vgt_stuck", "vgt_play", "vgt_more", "vgt_share",
             "u_delta_lag")  # fmt: skip
"""Fields of what acts on commands and inputs: positions at which valves stand still, 0 where they don't, widths [%],
further dead times [s] and how much of them acts, lag [s]."""

_ARGUMENTS_IN_C = {
    "p_im": "x.p_im", "n_e": "x.n_e", "u_egr": "x.u_egr", "u_vgt": "x.u_vgt", "omega_t": "x.omega_t",
    "W_c": "q.W_c", "W_cc": "corrected_flow(q.W_c, c)",
    **{name: f"at.{name}" for name in MapArguments._fields},
}  # fmt: skip

_TABLE = """/* Bilinear look-up over {nodes} x {nodes} nodes, held beyond the edges. */
static double looked_up(const double table[{nodes}][{nodes}], const double low[2], const double per_unit[2],
                        double x, double y)
{{
    double a = minimum(maximum((x - low[0]) * per_unit[0], 0.0), {last}.0);
    double b = minimum(maximum((y - low[1]) * per_unit[1], 0.0), {last}.0);
    const int i = a < {last}.0 ? (int)a : {last} - 1, j = b < {last}.0 ? (int)b : {last} - 1;
    a -= i;
    b -= j;
    return (1.0 - a) * ((1.0 - b) * table[i][j] + b * table[i][j + 1]) +
           a * ((1.0 - b) * table[i + 1][j] + b * table[i + 1][j + 1]);
}}
"""


@dataclass
class TermsInC:
    """Texts of the functions that the terms of an engine become.

    Args:
        terms: of the engine.
        translation: takes what of the equations they need.
    """

    terms: Sequence[OneTerm]
    translation: Translation
    texts: list[str] = field(default_factory=list)
    _count: int = 0

    @property
    def state_effects(self) -> tuple[str, ...]:
        """Effects inside the right-hand side that the engine has."""
        present = {term.slot for term in effect_terms(self.terms)}
        return tuple(name for name in STATE_EFFECTS if name in present)

    @property
    def readings(self) -> tuple[str, ...]:
        """Slots of the faults of sensors that the engine has, in the order in which they act."""
        present = {term.slot for term in effect_terms(self.terms)}
        return tuple(slot for slot in SENSOR_SLOTS if slot in present)

    @property
    def longest_dead_time_s(self) -> float:
        """All further dead times together [s]."""
        return sum(self._most(name) for name in ("egr_more", "vgt_more"))

    def write(self) -> list[str]:
        """All functions."""
        self._magnitudes()
        self._actuators()
        self._laws()
        self._corrections()
        self._readings()
        return self.texts

    # Where a term acts

    def _acting(self, term: EffectTerm | LawTerm) -> str:
        """Factor of a term over an interval, "" where it always acts wholly."""
        times = [] if term.onset_s is None else [f"t >= {number(term.onset_s)}"]
        times += [] if term.until_s is None else [f"t < {number(term.until_s)}"]
        times += [f"!(t >= {number(gone)} && t < {number(again)})" for gone, again in term.gone_s]
        parts = []
        if times or term.grown_s is not None:
            name = self._factor("when", "double t", f"{' && '.join(times) or '1'} ? {_grown(term)} : 0.0")
            parts.append(f"{name}(t)")
        if term.region:
            ranges = [f"u.{column} >= {number(low)} && u.{column} <= {number(high)}"
                      for column, (low, high) in term.region.items()]  # fmt: skip
            name = self._factor("where", "Inputs u", f"{' && '.join(ranges)} ? 1.0 : 0.0")
            parts.append(f"0.5 * ({name}(begin) + {name}(end))")
        effect = EFFECTS[term.effect] if isinstance(term, Term) else None
        if isinstance(term, Term) and effect is not None and effect.follows is not None:
            self._count += 1
            coefficients = {**effect.coefficients, **term.shape}
            equation = Equation.of(effect.follows)
            signature = self.translation.with_values(
                f"{equation.node.name}_{self._count}", equation, {"coefficients": coefficients}, {"columns": "Inputs"}
            )
            parts.append(f"{signature.name}(begin)")
        return " * ".join(parts)

    def _factor(self, head: str, argument: str, value: str) -> str:
        """Name of a function that says when or where a term acts."""
        self._count += 1
        name = f"{head}_{self._count}"
        self.texts.append(f"static double {name}({argument})\n{{\n    return {value};\n}}\n")
        return name

    def _amount(self, slots: Sequence[str]) -> str:
        """Sum of the magnitudes in some slots over an interval, "0.0" where there are none."""
        parts = []
        for term in effect_terms(self.terms):
            if term.slot in slots:
                acting = self._acting(term)
                drift = " * maximum(t, 0.0)" if term.slot in EFFECTS and EFFECTS[term.slot].drifts else ""
                parts.append(number(term.magnitude) + (f" * {acting}" if acting else "") + drift)
        return " + ".join(parts) or "0.0"

    def _most(self, actuator: str) -> float:
        slots = [name for name in ACTUATION_EFFECTS if EFFECTS[name].enters == _COMMANDS[actuator]]
        return sum(term.magnitude for term in effect_terms(self.terms) if term.slot in slots)

    def _function(self, head: str, lines: Sequence[str], words: str) -> None:
        body = "".join(f"    {line}\n" for line in lines)
        self.texts.append(f"/* {words} */\nstatic {head}\n{{\n{body}}}\n")

    # The functions

    def _magnitudes(self) -> None:
        fields = [f".{name} = {self._amount([name])}," for name in self.state_effects] or [".none = 0.0,"]
        unused = "(void)t, (void)begin, (void)end;"
        self._function(f"Magnitudes magnitudes({WHEN})", [unused, "return (Magnitudes){", *(f"    {f}" for f in fields),
                       "};"], "Magnitudes of the effects over an interval [their units]; a drift's is rate times time.")
        gas = next(iter(n for n in self.state_effects if EFFECTS[n].enters.through == "gas"), "")
        self._function("double thermal_inertia(Magnitudes m)", ["(void)m;", f"return {f'm.{gas}' if gas else '0.0'};"],
                       "Time constant of the gas temperature in the exhaust manifold [s], 0 for none.")

    def _actuators(self) -> None:
        values = {}
        for name, entry in _COMMANDS.items():
            slots = [effect for effect in ACTUATION_EFFECTS if EFFECTS[effect].enters == entry]
            amount = self._amount(slots)
            if name.endswith("_more"):
                most = self._most(name)
                values[name] = number(most)
                values[name.replace("more", "share")] = f"({amount}) / {number(most)}" if most else "0.0"
            else:
                values[name] = amount
        lines = ["(void)t, (void)begin, (void)end;", "return (Actuators){",
                 *(f"    .{name} = {values[name]}," for name in ACTUATORS), "};"]  # fmt: skip
        self._function(f"Actuators actuators({WHEN})", lines,
                       "What acts on commands and inputs over an interval: where valves stand still and play [%], "
                       "further dead time and lag [s].")

    def _laws(self) -> None:
        laws = law_terms(self.terms)
        shares = [f"out[{k}] = {self._acting(law) or '1.0'};" for k, law in enumerate(laws)]
        self._function(f"void law_shares(double *out, {WHEN})",
                       ["(void)out, (void)t, (void)begin, (void)end;", *shares],
                       "How much of each law acts over an interval.")
        if not laws:
            return
        self.translation.need("nozzle_flow_factor")
        lines = ["Signals s = {0};"]
        for k, law in enumerate(laws):
            words = " ".join(law.text.split()).replace("*/", "* /")
            lines += [f"/* {words or law.point} */",
                      f"s.{law.point} += shares[{k}] * {law_text(law, OperatingPoint._fields)};"]
        self._function("Signals law_signals(Quantities q, OperatingPoint x, double t, const double *shares, "
                       "Constants c)", ["(void)q, (void)x, (void)t, (void)c;", *lines, "return s;"],
                       "What the found laws say where they enter, at quantities q and operating point x.")

    def _corrections(self) -> None:
        head = "Signals corrected(Signals s, OperatingPoint x, Quantities q, Constants c)"
        coefficients = corrections_in(self.terms)
        if coefficients is None:
            self._function(head, ["(void)x, (void)q, (void)c;", "return s;"], "No corrections of maps are learned.")
            return
        learned = corrections_of(coefficients)
        nodes = learned.tables.shape[1]
        rows = ",\n".join(
            "{" + ",\n".join("{" + ", ".join(f"{v:.9g}" for v in row) + "}" for row in table) + "}"
            for table in learned.tables
        )
        used = GRIDS[: len(learned.tables)]
        ends = {
            name: "{" + ", ".join("{" + ", ".join(number(v) for v in pair) + "}" for pair in values[: len(used)]) + "}"
            for name, values in (("low", learned.low), ("per_unit", learned.per_unit))
        }
        self.texts.append(
            f"/* Learned relative corrections of {', '.join(point for point, _ in used)}, first node of both\n"
            f"   arguments, nodes a unit. */\n"
            f"static const double CORRECTIONS[{len(used)}][{nodes}][{nodes}] = {{\n{rows}\n}};\n"
            f"static const double CORRECTION_LOW[{len(used)}][2] = {ends['low']};\n"
            f"static const double CORRECTION_PER_UNIT[{len(used)}][2] = {ends['per_unit']};\n"
        )
        self.texts.append(_TABLE.format(nodes=nodes, last=nodes - 1))
        self.translation.need("map_arguments")
        self.translation.need("corrected_flow")
        lines = ["const MapArguments at = map_arguments(x.p_im, x.p_em, x.omega_t, q.p_bc, q.p_es, q.T_em, c);"]
        for m, (point, arguments) in enumerate(used):
            variables = [variable_of(point, name, _ARGUMENTS_IN_C) for name in arguments]
            x, y = (*(_ARGUMENTS_IN_C[name] for name in variables), "0.0")[:2]
            lines.append(f"s.{point} += looked_up(CORRECTIONS[{m}], CORRECTION_LOW[{m}], CORRECTION_PER_UNIT[{m}],\n"
                         f"                       {x}, {y});")
        self._function(head, [*lines, "return s;"],
                       "Signals with the maps' corrections at the maps' own arguments; q: of the evaluation before.")

    def _readings(self) -> None:
        amounts = [f"out[{k}] = {self._amount([slot])};" for k, slot in enumerate(self.readings)]
        self._function(f"void reading_amounts(double *out, {WHEN})",
                       ["(void)out, (void)t, (void)begin, (void)end;", *amounts],
                       f"Magnitudes of the faults of sensors: {', '.join(self.readings) or 'none'}.")

    def reading_of(self, column: str, true_value: str) -> str:
        """A sensor's reading in C where the engine `e` has faults of that sensor, else the true value."""
        text = true_value
        for k, slot in enumerate(self.readings):
            of, fault = slot_parts(slot)
            if of == column:
                text = {"lag": f"e->reading[{k}]", "gain": f"({text}) * (1.0 + e->amount[{k}])",
                        "offset": f"({text}) + e->amount[{k}]"}[fault]
        return text


def _grown(term: Limited) -> str:
    """Share of its magnitude that a term has come to at the time t, see `engine.courses.course`."""
    if term.grown_s is None:
        return "1.0"
    first = term.onset_s or 0.0
    return f"minimum(maximum((t - {number(first)}) / {number(growing_s(first, term.grown_s))}, 0.0), 1.0)"
