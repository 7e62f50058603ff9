"""Running the examples of a docstring."""

import doctest

import curlfit

_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def run_examples(name, namespace):
    """What fails in the examples of a public name, as text; `namespace` holds
    what they use."""
    text = getattr(curlfit, name).__doc__
    test = doctest.DocTestParser().get_doctest(text, namespace, name, None, None)
    if not test.examples:
        return f"{name} has no example"
    test.globs = namespace  # what an example defines is there for the next
    failures = []
    doctest.DocTestRunner(optionflags=_FLAGS).run(
        test, out=failures.append, clear_globs=False
    )
    return "".join(failures)
