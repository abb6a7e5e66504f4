"""Models of files: they are built when they are first used, so all of them are built here."""

import importlib
import pkgutil
from collections.abc import Iterator

import cmbot
from cmbot.common.reading.validation import FileModel


def models(base: type[FileModel] = FileModel) -> Iterator[type[FileModel]]:
    for model in base.__subclasses__():
        yield model
        yield from models(model)


def test_every_model_of_a_file_can_be_built_and_has_a_schema() -> None:
    for package in pkgutil.walk_packages(cmbot.__path__, "cmbot."):
        if not package.name.endswith("__main__"):
            importlib.import_module(package.name)
    every = set(models())
    assert {"Scene", "MeasurementFile", "CampaignFile"} <= {model.__name__ for model in every}
    for model in every:
        assert model.model_json_schema()
        assert model.__pydantic_complete__
