"""Arrays of FMI 3.0 by their elements: each, e.g. `A[1,2]`, is a variable of its own."""

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from functools import lru_cache
from itertools import product
from math import prod
from typing import Any, NamedTuple

from cosim.errors import FmuError

_MOST_ELEMENTS = 1_000_000  # of the arrays of a file
_ONLY_THE_FMU_KNOWS = ""  # a start value


class Element:
    """An element of an array; what is not said here is as for the array.

    Attributes:
        name: With the indices, which begin at 1.
        array: fmpy's variable.
        place, size: Of the element, and of the array, in the order in which the FMU passes them.
        start: Start value; "" if the FMU has one that the file does not tell.
        derivative: The element whose derivative it is; None if it is none.
    """

    dimensions = shape = ()
    derivative: "Element | None" = None

    def __init__(self, array: Any, indices: str, place: int, size: int, start: str | None) -> None:
        self.array, self.name = array, f"{array.name}[{indices}]"
        self.place, self.size, self.start = place, size, start

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("__"):  # as of `copy` and `pickle`
            raise AttributeError(attribute)
        return getattr(self.array, attribute)


def with_elements(description: Any, structural: Mapping[str, float] | None = None) -> Any:
    """Return fmpy's model description with the elements of its arrays as variables.

    Args:
        description: Of an FMU, with or without elements.
        structural: Values of structural parameters, which give sizes; those of the file for others.

    Raises:
        FmuError: The arrays are too large, or a derivative has another shape than its state.
    """
    return _with_elements(description, tuple(sorted((structural or {}).items())))


@lru_cache(8)
def _with_elements(description: Any, structural: tuple[tuple[str, float], ...]) -> Any:
    own = [v for v in description.modelVariables if not isinstance(v, Element)]
    if not any(variable.dimensions for variable in own):
        return description
    references = {variable.name: variable.valueReference for variable in own}
    sizes = {references[name]: value for name, value in structural}
    shapes = {id(v): _shape(v, sizes) for v in own if v.dimensions}
    if (count := sum(map(prod, shapes.values()))) > _MOST_ELEMENTS:
        raise FmuError(f"{description.modelName}: its arrays have {count} elements; give fewer")
    for v in own:
        if v.derivative is not None and shapes.get(id(v)) != shapes.get(id(v.derivative)):
            raise FmuError(
                f"{description.modelName}: {v.name} is the derivative of {v.derivative.name}, but "
                "of another shape; give both the same dimensions"
            )
    elements = {id(v): _elements(v, shapes[id(v)]) for v in own if v.dimensions}
    for variable in own:
        for element in elements.get(id(variable), ()):
            if variable.derivative is not None:
                element.derivative = elements[id(variable.derivative)][element.place]
    found = copy(description)
    found.modelVariables = [v for one in own for v in (one, *elements.get(id(one), ()))]
    found.numberOfContinuousStates, found.numberOfEventIndicators = (
        sum(prod(_shape(unknown.variable, sizes)) for unknown in unknowns)
        for unknowns in (description.derivatives, description.eventIndicators)
    )
    return found


def _shape(variable: Any, sizes: Mapping[int, float]) -> tuple[int, ...]:
    return tuple(
        int(sizes.get(d.valueReference, d.variable.start) if d.start is None else d.start)
        for d in variable.dimensions
    )


def _elements(array: Any, shape: Sequence[int]) -> list[Element]:
    size, texts = prod(shape), (array.start or "").split()
    if len(texts) == 1:
        texts *= size
    if len(texts) != size:
        texts = [_ONLY_THE_FMU_KNOWS] * size
    starts = texts if array.start is not None else [None] * size
    indices = product(*(range(1, n + 1) for n in shape))
    return [
        Element(array, ",".join(map(str, one)), place, size, start)
        for place, (one, start) in enumerate(zip(indices, starts, strict=True))
    ]


def elements_of(array: Any, variables: Iterable[Any]) -> list[Element]:
    """Return the elements of an array among variables."""
    return [v for v in variables if isinstance(v, Element) and v.array is array]


class Layout(NamedTuple):
    """How an FMU passes variables of one type: an array as a whole, also for a part of it.

    Attributes:
        references: Value references.
        values: Their number.
        places: Of each variable, among the values.
    """

    references: list[int]
    values: int
    places: list[int]

    @classmethod
    def of(cls, variables: Sequence[Any]) -> "Layout":
        """Return the layout of scalars and elements."""
        references, begins, count, places = list[int](), dict[int, int](), 0, list[int]()
        for variable in variables:
            element = isinstance(variable, Element)
            key = id(variable.array) if element else id(variable)
            if key not in begins:
                begins[key] = count
                references.append(variable.valueReference)
                count += variable.size if element else 1
            places.append(begins[key] + (variable.place if element else 0))
        return cls(references, count, places)


class Access:
    """Gets and sets variables of any type that is a number, through fmpy's instance.

    Args:
        instance: In a mode in which the variables have values.
        layouts: Of scalars and elements by the type in the names of the functions, e.g. "Float64",
            with their places among all variables.
    """

    def __init__(self, instance: Any, layouts: Sequence[tuple[str, Layout, list[int]]]) -> None:
        self._groups = []
        for kind, layout, columns in layouts:
            functions = getattr(instance, f"get{kind}"), getattr(instance, f"set{kind}")
            self._groups.append((*functions, layout, columns, kind == "Boolean"))
        self._width = sum(len(columns) for _, _, columns in layouts)
        self._buffers: list[list[Any]] | None = None

    def get(self) -> list[Any]:
        """Return the value of each variable."""
        found: list[Any] = [None] * self._width
        for (*_, layout, columns, truth), values in zip(self._groups, self._values(), strict=True):
            for column, place in zip(columns, layout.places, strict=True):
                found[column] = bool(values[place]) if truth else values[place]
        return found

    def set(self, values: Sequence[Any]) -> None:
        """Set each variable; other elements of their arrays stay as they were at the first call."""
        if self._buffers is None:
            partial = any(layout.values > len(columns) for *_, layout, columns, _ in self._groups)
            empty = [[None] * group[2].values for group in self._groups]
            self._buffers = self._values() if partial else empty
        for (_, setter, layout, columns, _), buffer in zip(
            self._groups, self._buffers, strict=True
        ):
            for column, place in zip(columns, layout.places, strict=True):
                buffer[place] = values[column]
            setter(layout.references, buffer)

    def _values(self) -> list[list[Any]]:
        return [
            getter(layout.references)
            if layout.values == len(layout.references)
            else getter(layout.references, layout.values)
            for getter, _, layout, *_ in self._groups
        ]
