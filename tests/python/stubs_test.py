# SPDX-License-Identifier: Apache-2.0
"""The stubs must contain the names of the module, with the same arguments and defaults in the same
order. Every public name must have a docstring."""
import ast
import pathlib
import unittest

import relidar

STUBS = ast.parse((pathlib.Path(relidar.__file__).parent / "__init__.pyi").read_text())
UNDOCUMENTED = {"__init__", "__getitem__", "__setitem__", "__len__", "__repr__"}


def list_arguments(function):
    """Returns names and defaults: ["track", "*", "overwrite=False"]."""
    def plain(argument, default):
        return argument.arg + ("" if default is None else "=" + ast.unparse(default))

    a = function.args
    defaults = [None] * (len(a.args) - len(a.defaults)) + a.defaults
    listed = [plain(x, d) for x, d in zip(a.args, defaults) if x.arg != "self"]
    return listed + (["*"] if a.kwonlyargs else []) + [plain(x, d) for x, d in zip(a.kwonlyargs, a.kw_defaults)]


def read_signature(function):
    """Parses the signature that pybind11 writes into the first line of the docstring."""
    return ast.parse(f"def {function.__doc__.splitlines()[0]}: ...").body[0]


def stub_functions(node):
    """Returns functions of a class or of the module in the stubs."""
    return {item.name: item for item in node.body if isinstance(item, ast.FunctionDef)}


def public_names(thing):
    return {name for name in vars(thing) if not name.startswith("_")}


class Stubs(unittest.TestCase):
    def check_function(self, where, stub, function):
        self.assertEqual(list_arguments(stub), list_arguments(read_signature(function)), where)

    def check_documented(self, where, function):
        signature, _, text = function.__doc__.partition("\n")
        self.assertIn("->", signature, where)
        self.assertTrue(text.strip(), f"{where} has no docstring")

    def test_functions_have_the_same_arguments(self):
        stubs = stub_functions(STUBS)
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
        if issubclass(bound, Exception):
            self.assertEqual([ast.unparse(base) for base in node.bases], [base.__name__ for base in bound.__bases__])
            return
        functions = stub_functions(node)
        properties = {item.target.id for item in node.body if isinstance(item, ast.AnnAssign)}
        self.assertEqual({name for name, value in vars(bound).items() if isinstance(value, property)}, properties, name)
        self.assertEqual({m for m in functions if not m.startswith("_")}, public_names(bound) - properties, name)
        for member, stub in functions.items():
            where, function = f"{name}.{member}", getattr(bound, member)
            self.check_function(where, stub, function)
            if member not in UNDOCUMENTED:
                self.check_documented(where, function)


if __name__ == "__main__":
    unittest.main()
