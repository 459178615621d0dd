"""Studies that tests write and read."""

from lidarcfg.study.loading import load_study


def study_of(folder, text):
    """The study that a YAML text in a folder's study.yaml says."""
    path = folder / "study.yaml"
    path.write_text(text)
    return load_study(path)
