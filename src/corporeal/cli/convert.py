"""``corporeal convert``: model files between the official layouts and ours, pickles and archives."""

from __future__ import annotations

import warnings

from rich.console import Console

from corporeal.cli.commands import Convert
from corporeal.cli.errors import CommandError
from corporeal.cli.files import write_result
from corporeal.cli.info import described
from corporeal.cli.named_models import named_model
from corporeal.model.files import LeftHandWarning, ModelFileError, load_model, save_model


def run(config: Convert) -> int:
    """Read one model and write it.

    Raises:
        CommandError: the source cannot be read or the target not be written, or a wrong call.
    """
    _check_call(config)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LeftHandWarning)
        try:
            if config.right is None:
                model = named_model(config.source)
            else:
                model = load_model(config.source, right=config.right, repair_left=config.repair_left)
            save_model(model, config.target, layout=config.layout, precision=config.precision)
        except ModelFileError as error:
            raise CommandError(f"convert: {error}") from error
    remedy = "--right MANO_RIGHT.pkl" if config.right is None else "--repair-left"
    messages = [f"{warning.message}; here: {remedy}" for warning in caught]
    console = Console(stderr=True)
    for message in [*messages, f"{config.target}: written, {config.target.stat().st_size / 1e6:.1f} MB"]:
        console.print(message, highlight=False, markup=False, soft_wrap=True)
    if config.json is not None:
        content = {
            "source": str(config.source),
            "target": str(config.target),
            "layout": config.layout,
            "precision": config.precision,
            "model": described(model),
            "warnings": messages,
        }
        write_result(config.json, content)
    return 0


def _check_call(config: Convert) -> None:
    if config.target.suffix not in (".npz", ".pkl"):
        raise CommandError(f"convert: {config.target}: name a target that ends in .npz or .pkl", 2)
    if config.source.resolve() == config.target.resolve():
        raise CommandError(f"convert: {config.target} is the source itself; name another target", 2)
    if config.repair_left and config.right is None:
        raise CommandError("convert: --repair-left needs --right FILE to compare with", 2)
