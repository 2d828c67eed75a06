"""The folder that MLflow serves: networks, the code that runs them (`tasks.champion`), signature, an input example."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from tasks.store import scratch

if TYPE_CHECKING:
    import pandas as pd

MODEL_FILE = "MLmodel"
NETWORKS = Path("artifacts") / "networks"

CODE = Path(__file__).with_name("champion.py")


def write_model(folder: Path, networks: Path, code: Path, driving: pd.DataFrame) -> None:
    """Write an MLflow model of these networks.

    Args:
        folder: where it is written; it isn't there yet.
        networks: folder of trained networks.
        code: `CODE`.
        driving: rows of a recording, for the example.
    """
    import mlflow
    import yaml
    from mlflow.models import ModelSignature
    from mlflow.types import ColSpec, ParamSchema, ParamSpec, Schema

    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.version import __version__
    from tasks import champion

    for name in ("mlflow", "mlflow.pyfunc"):
        logging.getLogger(name).setLevel(logging.ERROR)
    engine = EmpiricalMaps.load(networks / champion.MAPS).parameters
    parameters = {name: float(getattr(engine, own)) for name, own in champion.PARAMETERS.items()}
    signature = ModelSignature(
        Schema([ColSpec("double", name) for name in champion.INPUTS]),
        Schema([ColSpec("double", name) for name in champion.OUTPUTS]),
        ParamSchema([ParamSpec(name, "double", value) for name, value in parameters.items()]),
    )
    with scratch(folder.parent) as made:
        named = made / NETWORKS.name  # MLflow keeps the folder's name
        shutil.copytree(networks, named)
        mlflow.pyfunc.save_model(
            folder,
            python_model=str(code),
            artifacts={"networks": str(named)},
            signature=signature,
            input_example=(driving[list(champion.INPUTS)].reset_index(drop=True), parameters),
            pip_requirements=[f"dieseltwin[networks]=={__version__}", f"mlflow=={mlflow.__version__}"],
            model_config={"compiled": True},
        )
    # MLflow writes where the files came from; nothing reads it, and it is a path of one machine
    content = yaml.safe_load((folder / MODEL_FILE).read_text(encoding="utf-8"))
    flavour = content["flavors"]["python_function"]
    flavour["model_code_path"] = code.name
    flavour["artifacts"]["networks"]["uri"] = NETWORKS.as_posix()
    (folder / MODEL_FILE).write_text(yaml.safe_dump(content), encoding="utf-8")
