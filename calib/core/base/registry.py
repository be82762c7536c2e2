"""Classes by name: those of this package, and those of other packages.

Another package names its classes in its `pyproject.toml`, in the registry's group of entry points; a notebook or script
calls `register`. Names are looked up at first use, so that nothing of another package is imported before.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from functools import cache, lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import isabstract
from typing import Any, Generic, TypeVar

from pydantic import (
    GetJsonSchemaHandler,
    GetPydanticSchema,
    PlainValidator,
    SerializeAsAny,
    TypeAdapter,
    ValidationInfo,
)

from calib.core.base.errors import DescriptionError, require_known
from calib.core.base.sections import Section
from calib.core.base.words import warn_once

Class = TypeVar("Class")


_CAPABILITIES = "calib.capabilities"  # by name: the core imports no capability


def list_entry_points(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group: those of the capabilities, then those of other packages by their names.

    All installed packages are looked through, once for each search path of modules: that takes longer than many fits.
    """
    return _find_entry_points(tuple(sys.path)).get(group, ())


@lru_cache(maxsize=4)
def _find_entry_points(path: tuple[str, ...]) -> dict[str, tuple[EntryPoint, ...]]:
    own, found = import_module(_CAPABILITIES).ENTRY_POINTS, entry_points()
    others = {group: sorted(found.select(group=group), key=lambda entry: entry.name) for group in found.groups}
    groups = {entry.group for entry in own} | others.keys()
    return {group: (*(each for each in own if each.group == group), *others.get(group, ())) for group in groups}


def load_entry(group: str, name: str) -> Any:
    """Return the object of an entry point, by its group and name; `KeyError` if there is none."""
    return {entry.name: entry for entry in reversed(list_entry_points(group))}[name].load()


def load_named(entry: EntryPoint, what: str) -> Any:
    """Return the object of an entry point; `what` names such objects in the message.

    `DescriptionError` if it cannot be loaded.
    """
    try:
        return entry.load()
    except Exception as error:  # another package may raise anything while it is imported
        raise DescriptionError(
            f"{what} '{entry.name}' ({entry.value}) cannot be loaded: {type(error).__name__}: {error};"
            " install its package again, or uninstall it"
        ) from None


def load_group(group: str, what: str) -> list[tuple[str, Any]]:
    """Return name and object of each entry point of a group; a warning names those that cannot be loaded."""
    loaded = []
    for entry in list_entry_points(group):
        try:
            loaded.append((entry.name, load_named(entry, what)))
        except DescriptionError as error:
            warn_once(str(error))
    return loaded


class Registry(Mapping[str, type[Class]], Generic[Class]):
    """Classes by name; first this package's in their order, then those that were registered, then other packages'.

    Args:
        what: Kind of such a class, in words, such as `joint term`.
        group: Group of the entry points.
        base: Base class of each.
        built_in: This package's.
        either: Methods of `base`; a class must define one of them.
    """

    def __init__(
        self,
        what: str,
        group: str,
        base: type[Class],
        built_in: Mapping[str, type[Class]],
        either: tuple[str, ...] = (),
    ) -> None:
        self.what, self.group, self._either = what, group, either
        self._base, self._built_in = base, dict(built_in)
        self._given: dict[str, type[Class]] = {}  # registered, or loaded before

    def register(self, name: str, given: type[Class]) -> None:
        """Add a class under a name; one that was registered before under this name is replaced.

        A class that worker processes need registers itself where it is defined: they import its module.
        `DescriptionError` if an installed package has the name, or the class is not complete.
        """
        if name in self._built_in or name in self._entries():
            raise DescriptionError(f"{self.what} '{name}': there is one already; give another name")
        self._given[name] = self._check_class(name, given, f"({given!r})")

    def __getitem__(self, name: str) -> type[Class]:
        """Return the class of a name, or raise `KeyError`; `DescriptionError` if that of another package is not
        complete.
        """
        known = self._built_in.get(name) or self._given.get(name)
        if known is None:
            entry = self._entries()[name]
            known = self._given[name] = self._check_class(name, load_named(entry, self.what), f"({entry.value})")
        return known

    def __contains__(self, name: object) -> bool:
        """Whether there is a class of this name; loads none."""
        return name in self._built_in or name in self._given or name in self._entries()

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(dict.fromkeys([*self._built_in, *self._given, *sorted(self._entries())]))

    def __len__(self) -> int:
        """Return how many names there are."""
        return sum(1 for _ in self)

    def _entries(self) -> dict[str, EntryPoint]:
        """Entry points of other packages by name; one that has a taken name is a `DescriptionError`."""
        entries: dict[str, EntryPoint] = {}
        for entry in list_entry_points(self.group):
            other = entries.setdefault(entry.name, entry)
            if entry.name in self._built_in or other.value != entry.value:
                known = f" ({other.value})" if other.value != entry.value else ""
                raise DescriptionError(
                    f"{self.what} '{entry.name}' ({entry.value}): another package has the same name{known}; uninstall"
                    " one of the packages, or have it renamed"
                )
        return entries

    def _check_class(self, name: str, given: object, where: str) -> type[Class]:
        if not (isinstance(given, type) and issubclass(given, self._base)):
            raise DescriptionError(f"{self.what} '{name}' {where}: is not derived from {self._base.__qualname__}")
        if isabstract(given):
            missing = ", ".join(sorted(getattr(given, "__abstractmethods__", ())))
            raise DescriptionError(f"{self.what} '{name}' {where}: does not define {missing}")
        if self._either and all(getattr(given, method) is getattr(self._base, method) for method in self._either):
            raise DescriptionError(f"{self.what} '{name}' {where}: defines neither {' nor '.join(self._either)}")
        return given


def entry(key: str, registry: Registry[Any]) -> tuple[Any, ...]:
    """Return metadata of `Annotated` that read an entry of a description, by the class that the entry's key names.

    Reading raises `ValueError` if the key names no class.
    """

    def read(value: Any, info: ValidationInfo) -> Section:
        if not isinstance(value, (dict, Section)):
            such = f"{{{key}: {next(iter(registry))}}}"
            raise ValueError(f"should be keys and values, such as {such} (given: {value!r:.60})")
        name = value.get(key) if isinstance(value, dict) else getattr(value, key, None)
        if name is None:
            raise ValueError(f"needs a key '{key}', one of {', '.join(registry)}")
        try:
            require_known(str(name), registry, f"unknown {key}", ValueError)
            section = registry[str(name)].section
        except DescriptionError as error:
            raise ValueError(str(error)) from None
        return value if isinstance(value, section) else section.model_validate(value, context=info.context)

    def schema(_: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schemas = []
        for name in registry:
            section = registry[name].section
            section.model_rebuild()
            schema = handler.resolve_ref_schema(handler(section.__pydantic_core_schema__)).copy()
            schema["properties"] = schema["properties"] | {key: {"const": name}}
            schemas.append(schema)
        return {"anyOf": schemas}

    return PlainValidator(read), SerializeAsAny(), GetPydanticSchema(None, schema)  # type: ignore[type-arg]


def capability_entry(key: str) -> tuple[Any, ...]:
    """Return metadata of `Annotated` that read an entry of a description as a capability does (`calib.entries`).

    The capability is loaded when there is such an entry. Without one, the value is None.
    """

    @cache
    def adapter() -> TypeAdapter[Any]:
        return TypeAdapter(load_entry("calib.entries", key) | None)

    def read(value: Any, info: ValidationInfo) -> Any:
        return adapter().validate_python(value, context=info.context)

    return PlainValidator(read), GetPydanticSchema(None, lambda _, handler: handler(adapter().core_schema))
