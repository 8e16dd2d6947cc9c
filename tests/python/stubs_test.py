# SPDX-License-Identifier: Apache-2.0
"""The stubs must contain the names of the module, with the same arguments and defaults in the same
order. Every public name must have a docstring."""
import ast
import pathlib
import re
import unittest

import relidar

STUBS = ast.parse((pathlib.Path(relidar.__file__).parent / "__init__.pyi").read_text())
UNDOCUMENTED = {"__init__", "__getitem__", "__setitem__", "__len__", "__repr__"}


def stub_arguments(function):
    """Returns arguments in the notation of pybind11: ["self", "track", "*", "overwrite=False"]."""
    def plain(argument, default):
        return argument.arg + ("" if default is None else "=" + ast.unparse(default))

    a = function.args
    defaults = [None] * (len(a.args) - len(a.defaults)) + a.defaults
    listed = [plain(x, d) for x, d in zip(a.args, defaults)]
    return listed + (["*"] if a.kwonlyargs else []) + [plain(x, d) for x, d in zip(a.kwonlyargs, a.kw_defaults)]


def split_arguments(text):
    """Splits an argument list at the commas outside of brackets."""
    parts, depth, part = [], 0, ""
    for c in text:
        depth += (c in "[({<") - (c in "])}>")
        if c == "," and depth == 0:
            parts.append(part.strip())
            part = ""
        else:
            part += c
    return parts + ([part.strip()] if part.strip() else [])


def module_arguments(function):
    """Returns the arguments of a bound function. pybind11 writes its signature into the first line
    of the docstring."""
    line = function.__doc__.splitlines()[0]
    text = line[line.index("(") + 1 : line.rindex(") ->")]
    arguments = []
    for part in split_arguments(text):
        name, _, rest = part.partition(":")
        default = re.search(r" = (.*)$", rest)
        arguments.append(name + ("=" + default.group(1) if default else ""))
    return arguments


def stub_members(node):
    """Returns functions and properties of a class or of the module in the stubs."""
    return {item.name: item for item in node.body if isinstance(item, ast.FunctionDef)}


def is_property(function):
    return any(isinstance(d, ast.Name) and d.id == "property" for d in function.decorator_list)


def public_names(thing):
    return {name for name in vars(thing) if not name.startswith("_")}


class Stubs(unittest.TestCase):
    def check_function(self, where, stub, function):
        expected, actual = stub_arguments(stub), module_arguments(function)
        if expected and expected[0] == "self":
            expected, actual = expected[1:], actual[1:]
        self.assertEqual([x.replace("'", '"') for x in expected], [x.replace("'", '"') for x in actual], where)

    def check_documented(self, where, function):
        signature, _, text = function.__doc__.partition("\n")
        self.assertIn("->", signature, where)
        self.assertTrue(text.strip(), f"{where} has no docstring")

    def test_functions_have_the_same_arguments(self):
        stubs = stub_members(STUBS)
        bound = {name for name in public_names(relidar) if type(getattr(relidar, name)).__name__ == "builtin_function_or_method"}
        self.assertEqual(set(stubs), bound)
        for name, stub in stubs.items():
            self.check_function(name, stub, getattr(relidar, name))
            self.check_documented(name, getattr(relidar, name))

    def test_classes_have_the_same_members(self):
        classes = {item.name: item for item in STUBS.body if isinstance(item, ast.ClassDef) and not item.name.startswith("_")}
        self.assertEqual(set(classes), {name for name in public_names(relidar) if isinstance(getattr(relidar, name), type)})
        for name, node in classes.items():
            self.check_class(name, node, getattr(relidar, name))

    def check_class(self, name, node, bound):
        self.assertTrue(bound.__doc__, f"{name} has no docstring")
        members = stub_members(node)
        if issubclass(bound, Exception):
            self.assertEqual([ast.unparse(base) for base in node.bases], [base.__name__ for base in bound.__bases__])
            return
        listed = {m for m in members if not m.startswith("_")}
        self.assertEqual(listed, public_names(bound), name)
        for member, stub in members.items():
            where, value = f"{name}.{member}", vars(bound)[member]
            if is_property(stub):
                self.assertIsInstance(value, property, where)
            else:
                self.check_function(where, stub, getattr(bound, member))
                if member not in UNDOCUMENTED:
                    self.check_documented(where, getattr(bound, member))


if __name__ == "__main__":
    unittest.main()
