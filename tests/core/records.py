"""Structs of the core, with other fields."""


def fields_of(record):
    """Its fields by name."""
    return {name: getattr(record, name) for name, value in vars(type(record)).items() if isinstance(value, property)}


def replaced(record, **changed):
    """A struct with some fields changed."""
    return type(record)(**fields_of(record) | changed)
