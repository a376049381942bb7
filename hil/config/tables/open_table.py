"""Tables of configuration files in which others than this package declare further tables: drivers and parts."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any, ClassVar, Self, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from hil.config.tables.model import ConfigModel
from hil.core.part import GROUP, declared, imported
from hil.errors import BadInput, one_line


def model_of_field(model: type[BaseModel], key: str) -> type[BaseModel] | None:
    """Return the model of the table in the field ``key``, None if there is no such field or it is no table."""
    if key not in model.model_fields:
        return None
    annotation = model.model_fields[key].annotation
    candidates = [annotation, *get_args(annotation)]
    return next((each for each in candidates if isinstance(each, type) and issubclass(each, BaseModel)), None)


class OpenTable(ConfigModel):
    """Table that may hold tables in addition to its fields, each validated by the model that is declared for it.

    They are in ``model_extra``, as far as the file has them.
    """

    model_config = ConfigDict(extra="allow")  # ``_validate_added`` rejects all other keys

    @classmethod
    def added_model(cls, key: str) -> type[BaseModel] | None:
        """Return the model of the added table ``key``, None if none is declared."""
        raise NotImplementedError

    @classmethod
    def model_of(cls, key: str) -> type[BaseModel] | None:
        """Return the model of the table ``key``: a field's, or that of an added one; None for other keys."""
        return model_of_field(cls, key) if key in cls.model_fields else cls.added_model(key)

    @classmethod
    def unknown_keys(cls, keys: Iterable[str]) -> list[str]:
        """Return those of ``keys`` that are neither fields nor added tables."""
        return [key for key in keys if key not in cls.model_fields and cls.model_of(key) is None]

    @model_validator(mode="after")
    def _validate_added(self) -> Self:
        tables = self.__pydantic_extra__
        assert tables is not None
        if unknown := self.unknown_keys(tables):
            faults: list[Any] = [{"type": "extra_forbidden", "loc": (key,), "input": tables[key]} for key in unknown]
            raise ValidationError.from_exception_data(type(self).__name__, faults)
        for key, table in tables.items():
            tables[key] = self._validated(key, table)
        return self

    @classmethod
    def _validated(cls, key: str, table: Any) -> BaseModel:
        if isinstance(table, BaseModel):
            return table
        model = cls.model_of(key)
        assert model is not None
        try:
            return model.model_validate_json(json.dumps(table))  # as strict as the file itself
        except ValidationError as error:
            faults: list[Any] = [{**fault, "loc": (key, *fault["loc"])} for fault in error.errors(include_url=False)]
            raise ValidationError.from_exception_data(cls.__name__, faults) from error


class FileTable(OpenTable):
    """Whole file, to which parts add tables: ``[tracker]``. prefix: of the keys in ``Part.tables``."""

    prefix: ClassVar[str] = ""

    @classmethod
    def added_model(cls, key: str) -> type[BaseModel] | None:
        """Return the model of the table ``key`` of an installed part, None if there is none."""
        return cls.added_tables().get(key)

    @classmethod
    def added_tables(cls) -> dict[str, type[BaseModel]]:
        """Return the models of the tables that parts add to the file, by their keys. Raises BadInput for a part without
        its model."""
        tables = {}
        for key, path in declared("tables").items():
            if path and cls.owns(key):
                if (name := key.removeprefix(cls.prefix)) in cls.model_fields:
                    text = "declared by a part, but a key of the program itself: remove that part, see hil list parts"
                    raise BadInput.single(GROUP, f"[{key}]", text)
                tables[name] = _model_of_part(key, path)
        return tables

    @classmethod
    def owns(cls, key: str) -> bool:
        """Return whether ``key`` of ``Part.tables`` is of this file."""
        return key.startswith("rig.") == bool(cls.prefix)

    def table_of_part(self, key: str) -> Any:
        """Return the table ``key`` of a part, None if the file does not have it."""
        return (self.model_extra or {}).get(key)


def _model_of_part(key: str, path: str) -> type[BaseModel]:
    try:
        model = imported(path)
    except Exception as error:
        text = f"its model {path} cannot be imported: {one_line(f'{type(error).__name__}: {error}', 200)}"
        raise BadInput.single(GROUP, f"[{key}]", text) from error
    if not (isinstance(model, type) and issubclass(model, ConfigModel)):
        raise BadInput.single(GROUP, f"[{key}]", f"its model {path} is {model!r:.60}, expected a ConfigModel")
    return model
