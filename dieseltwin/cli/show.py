"""`dieseltwin engine show` and `dieseltwin params show`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer

from dieseltwin.cli.options import EngineFile, ParamsFile, Profile, help_without_command, say

WIDTH = 10_000  # one line a leaf, however long

engine_app = typer.Typer(help="Engine parameters.")
params_app = typer.Typer(help="Settings of a run (params.yaml).")
engine_app.callback(invoke_without_command=True)(help_without_command)
params_app.callback(invoke_without_command=True)(help_without_command)


@engine_app.command("show")
def engine_show(engine: EngineFile = None) -> None:
    """Print the parameters of an engine, diesel or petrol, or of a rig as YAML that --engine accepts."""
    say(engine_lines(engine))


@params_app.command("show")
def params_show(params: ParamsFile = None, profile: Profile = "quick") -> None:
    """Print the settings of one profile as YAML, and their hash."""
    say(params_lines(params, profile))


def _plain_yaml(values: dict[str, Any]) -> Iterator[str]:
    import yaml

    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=WIDTH)
    yield from text.rstrip("\n").split("\n")


def _flow_yaml(value: Any) -> str:
    """A list or mapping on one line."""
    import yaml

    return yaml.safe_dump(value, sort_keys=False, allow_unicode=True, default_flow_style=True, width=WIDTH).strip()


def engine_lines(engine: EngineFile) -> Iterator[str]:
    """An engine (the published one without a file) as YAML; of a diesel engine with the units as comments."""
    from dieseltwin.api.engines import PUBLISHED, petrol_base
    from dieseltwin.api.engines import engine as engine_of
    from dieseltwin.engine import EngineParameters

    source = engine or PUBLISHED
    parameters = petrol_base(source) or engine_of(source)  # one without maps can be shown, too
    if not isinstance(parameters, EngineParameters):
        yield from _plain_yaml(parameters.model_dump(mode="json", exclude_none=True))
        return
    for name, value in parameters.model_dump(mode="json").items():
        description = EngineParameters.model_fields[name].description or ""
        if name == "terms":
            value = [{key: v for key, v in term.items() if v is not None} for term in value]
            line = f"terms: {_flow_yaml(value)}"
        else:
            line = "".join(_plain_yaml({name: value})).strip("{}")  # a scalar alone comes in braces
        yield f"{line}  # {description}" if description else line


def params_lines(params: ParamsFile, profile: str) -> Iterator[str]:
    """The settings of one profile as YAML, headed by their hash."""
    from dieseltwin.engine import we2011
    from dieseltwin.engine.parameters import validated
    from dieseltwin.settings.params import load_params

    loaded = load_params(params, profile)
    own = {**we2011.PARAMETERS.model_dump(), **loaded.engine.overrides}
    validated(own, f"{params or 'params.yaml'}: engine.overrides")  # settings know no engine
    yield f"# sha256 {loaded.sha256}"
    yield from _plain_yaml(loaded.model_dump(mode="json"))
