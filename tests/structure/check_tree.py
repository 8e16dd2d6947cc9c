#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the source tree: includes, sizes, licences, and the names in documents.

usage: check_tree.py [--faults]
  --faults   also tests the rules: adds faults to the tree in memory, which must be found
Prints each violation as "file:line: message". The exit code is 1 if there are any.
"""
import os
import pathlib
import posixpath
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
SKIPPED = {".git", "build", "demo", "runs", ".cache", ".vscode", ".idea", "data", "__pycache__"}
CODE = (".cpp", ".hpp", ".h", ".comp", ".glsl", ".rgen")

# Rooms of src/, include/relidar/ and shaders/. A room includes only itself and the rooms
# before it.
ROOMS = ["base", "gpu", "log", "read", "registration", "scene", "diff", "run", "simulate", "score", "train"]
# Folders whose private headers all rooms may include. Other headers that rooms share
# must be public.
OPEN_FOLDERS = ("src/base/", "src/gpu/", "src/log/", "src/diff/traversal/")
# Headers of libraries, and the folders of src/ that may include them.
LIBRARIES = {
    "volk": "gpu", "vulkan/": "gpu", "Imf": "base/codecs", "png.h": "base/codecs", "zip.h": "base/codecs",
    "lz4frame.h": "base/codecs", "lz4.h": "base/codecs", "flatbuffers/": "base/codecs", "sqlite3.h": "read/bag",
    "bzlib.h": "read/bag", "proj.h": "log/georeference", "pcap/": "read/bag", "simdjson.h": "read/datasets",
    "protozero/": "read simulate/scan_files", "pugixml.hpp": "read", "toml++/": "log read run simulate/scan_files",
    "nlohmann/": "base gpu log read run simulate", "nanoflann.hpp": "base scene score", "tbb/": "base",
    "oneapi/tbb": "base", "Eigen/": "base log read registration scene score train"}
UMBRELLA = "include/relidar/relidar.hpp"
# Headers for users who write a trainer, and headers of options. <relidar/relidar.hpp>
# includes only the latter.
TRAINER_HEADERS = {"gpu/kernel.hpp", "gpu/stream.hpp", "log/sensor_pattern.hpp", "scene/device_scene.hpp",
                   "run/stage_options.hpp", "run/checkpoint.hpp"}
OPTION_HEADERS = {"diff/densify_options.hpp", "diff/loss_options.hpp", "diff/loss_terms.h", "diff/network.hpp"}
MAX_NAME = 28   # characters of a function name
# Namespaces that differ from their folder, because `relidar::relidar` would hide the
# outer namespace, and because shared structs have the same name in all rooms.
SPACES = {"cli": ("relidar", "relidar_dev"), "shared": ("include", "shared")}
# a call or declaration of a function that is not of a library
FUNCTION = r"(?<!::)\b(?!zip_|pcap_|posix_|proj_|register_exc)([a-z][a-z0-9_]*)(?=\()"
MAX_CHAIN, MAX_CHAIN_OF_TESTS = 8, 10

# Names in documents that are placeholders, or that a program creates.
PLACEHOLDERS = {"relidar/room/name.hpp", "src/room", "RELIDAR_UPPER", "kernel_params.hpp",
                "relidarTargets.cmake", "scores.md"}
SOURCES = {".cpp", ".hpp", ".h", ".glsl", ".comp", ".rgen", ".md", ".cmake", ".sh", ".py", ".js", ".css", ".proto"}
FILE_TABLE_ENDINGS = (".cpp", ".hpp", ".h", ".py", ".js", ".proto")   # of section 13 of architecture.md
# Endings of files that the program reads or writes. `word.ending` is such a file, even if
# `word` is a section of the settings.
FILE_ENDINGS = {"json", "toml", "csv", "npz", "safetensors", "jsonl", "html", "png", "exr", "ply", "pcd", "log",
                "txt", "svg"}


def read_tree():
    """Returns {path: text} of sources, scripts and documents."""
    tree = {}
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [f for f in folders if f not in SKIPPED and not f.startswith("cmake-build")]
        for name in files:
            path = pathlib.Path(folder, name)
            try:
                tree[path.relative_to(ROOT).as_posix()] = path.read_text("utf-8")
            except UnicodeDecodeError:   # a picture
                tree[path.relative_to(ROOT).as_posix()] = ""
    return dict(sorted(tree.items()))


def numbered(text):
    return enumerate(text.split("\n"), 1)


def has_word(text, word):
    return re.search(r"(?<!\w)" + re.escape(word) + r"(?!\w)", text) is not None


# ---- includes

def list_includes(tree, path):
    """Yields (line, path) of the included files of this project."""
    for line, text in numbered(tree[path]):
        match = re.match(r'\s*#\s*include\s*[<"]([^>"]+)[>"]', text)
        if not match:
            continue
        bases = ["include"] if "<" in text else [posixpath.dirname(path), "src", "shaders", "include", "tests", ""]
        for base in bases:
            target = posixpath.normpath(posixpath.join(base, match[1]))
            if target in tree:
                yield line, target
                break


def room_of(path):
    parts = path.split("/")
    name = parts[2 if path.startswith("include/relidar/") else 1]
    return ROOMS.index(name) if name in ROOMS else None


def reader_of(path):
    parts = path.split("/")
    return parts[3] if path.startswith("src/read/datasets/") and len(parts) > 4 else None


def judge_library(source, target):
    """Returns why a file of the library must not include another one, or None."""
    a, b = room_of(source), room_of(target)
    if source == UMBRELLA:
        return None
    if a is None or b is None:
        return "a file is in none of the rooms"
    if b > a:
        return f"{ROOMS[a]} may not include {ROOMS[b]}"
    if source.startswith("include/") and not target.startswith("include/"):
        return "a public header includes only public headers"
    if source.startswith("shaders/") and not target.startswith("shaders/") and not target.endswith((".h", ".glsl")):
        return "shaders include no C++"
    if reader_of(source) and reader_of(target) and reader_of(source) != reader_of(target):
        return "readers do not include each other"
    if a != b and target.startswith("src/") and not target.startswith(OPEN_FOLDERS):
        return f"another room is reached only through its public headers, <relidar/{ROOMS[b]}/...>"
    if source.startswith("src/") and target.startswith("shaders/") and "/shared/" not in target:
        return "C++ includes only shaders/*/shared"
    return None


def judge(source, target):
    """Returns why an include is not allowed, or None."""
    library = ("src/", "shaders/", "include/relidar/")
    if source.startswith(library):
        return judge_library(source, target) if target.startswith(library) else "the library includes only itself"
    top, part = source.split("/")[:2]
    is_public, street = (target.startswith("include/relidar/"),
                         target in ("src/scene/benchmark_street.hpp", "src/base/fail.hpp"))
    if top == "tools":
        allowed = [f"tools/{part}/", "tools/network/"]
        if part == "relidar":
            allowed += ["tools/view/", "tools/serve/"]
        if part in ("relidar_dev", "bench"):
            allowed += ["tools/relidar/", "tools/serve/", "src/"]
        if source.startswith("tools/relidar/check/"):   # compares private kernels with the reference
            allowed += ["src/", "tests/reference/", "tests/support/"]
        if not (is_public or street or target.startswith(tuple(allowed))):
            return "tools see only include/relidar"
    if source.startswith("tests/reference/"):
        is_test = source.endswith("_test.cpp")
        names_only = target == "include/relidar/diff/blended_values.h"
        if not (target.startswith("tests/reference/") or (is_test and (street or target.startswith("tests/support/")))
                or (is_public and (names_only or not target.endswith(".h")))):
            return "the reference includes nothing of src/, shaders/ or other tests"
    return None


def check_includes(tree):
    graph = {path: list(list_includes(tree, path)) for path in tree if path.endswith(CODE)}
    for path, includes in graph.items():
        for line, target in includes:
            if reason := judge(path, target):
                yield f"{path}:{line}: includes {target}: {reason}"
        if path.startswith(("src/", "include/")):
            for line, text in numbered(tree[path]):
                header = re.match(r"\s*#\s*include\s*<([^>]+)>", text)
                for library, folders in LIBRARIES.items() if header else ():
                    if header[1].startswith(library) and not path.startswith(tuple(f"src/{f}/" for f in folders.split())):
                        yield f"{path}:{line}: <{header[1]}> is not allowed here"
    longest = {}

    def chain(path, open_files):
        if path in open_files:
            return [path] * 99   # a cycle
        if path not in longest:
            longest[path] = [path] + max((chain(t, open_files | {path}) for _, t in graph.get(path, ())), key=len,
                                         default=[])
        return longest[path]
    for path in graph:
        if len(chain(path, frozenset())) > (MAX_CHAIN_OF_TESTS if path.startswith("tests/") else MAX_CHAIN):
            yield f"{path}:1: a cycle or a chain of more than {MAX_CHAIN} includes: {' '.join(chain(path, frozenset())[:12])}"


def check_folders(tree):
    """Finds circles of includes between the folders of src/."""
    graph = {}   # {folder: {included folder: the first include}}
    for path in tree:
        for line, target in list_includes(tree, path) if path.startswith("src/") and path.endswith(CODE) else ():
            here, there = posixpath.dirname(path), posixpath.dirname(target)
            if there != here and target.startswith("src/"):
                graph.setdefault(here, {}).setdefault(there, f"{path}:{line}: includes {target}")

    def find_path(here, goal, seen):
        for there in graph.get(here, {}):
            rest = [] if there == goal else None
            if rest is None and there not in seen:
                seen.add(there)
                rest = find_path(there, goal, seen)
            if rest is not None:
                return [there, *rest]
        return None
    for folder, includes in graph.items():
        for there, include in includes.items():
            if back := find_path(there, folder, {there}):
                yield f"{include}: a circle of folders: {' -> '.join([folder, there, *back])}"


def check_umbrella(tree):
    seen, todo = {UMBRELLA}, [UMBRELLA]
    while todo:
        path = todo.pop()
        for line, target in list_includes(tree, path) if path in tree else ():
            name = target.removeprefix("include/relidar/")
            is_deep = name in TRAINER_HEADERS or (name not in OPTION_HEADERS and (
                name.startswith("diff/") or (name.endswith(".h") and not name.startswith("scene/primitives"))))
            if target.startswith("include/relidar/") and is_deep:
                yield f"{path}:{line}: includes {target}, which <relidar/relidar.hpp> must not include"
            elif target not in seen:
                seen.add(target)
                todo.append(target)


# ---- sizes, names and licences of files

def line_limit(path):
    if path in ("src/train/train.cpp", "tools/relidar/main.cpp"):
        return 180
    if path.startswith("include/relidar/"):
        return 420
    if path.endswith(".comp"):
        return 220
    return 165 if path.startswith("shaders/") and path.endswith(".h") else 550


def check_files(tree):
    builds = "".join(text for path, text in tree.items() if path.endswith("CMakeLists.txt"))
    for path, text in tree.items():
        is_code, head = path.endswith(CODE), text.split("\n")[:3]
        if is_code or path.endswith((".cmake", ".py", ".sh", ".in", "CMakeLists.txt")) or text.startswith("#!"):
            if not any(re.search(r"SPDX-License-Identifier: Apache-2.0\W*$", line) for line in head):
                yield f"{path}:1: no SPDX-License-Identifier line at the top"
        if is_code and text.count("\n") > line_limit(path):
            yield f"{path}:1: {text.count(chr(10))} lines, at most {line_limit(path)}"
        # clang-format limits code. Indented comments are tables and equations.
        for line, comment in numbered(text) if is_code else ():
            if len(comment) > 90 and re.match(r"\s*//[/!<]* ? ?[^ /]", comment):
                yield f"{path}:{line}: {len(comment)} columns, at most 90"
        if path.startswith("tests/") and path.endswith("_test.cpp") and path.split("/")[-1] not in builds:
            yield f"{path}:1: no CMakeLists.txt contains this file"
        if path.startswith("shaders/") and path.endswith(".comp"):
            yield from check_kernel(tree, path)
        if path.startswith(("src/", "include/", "tools/", "tests/reference/")) and is_code \
                and not path.startswith(("src/gpu/", "src/diff/accel/")):
            for line, code in numbered(text):
                if name := re.search(r"\b(vk|Vk|VK_)[A-Z]\w*", re.sub(r'//.*|"[^"]*"', "", code)):
                    yield f"{path}:{line}: {name[0]} outside src/gpu and src/diff/accel"


def check_kernel(tree, path):
    """Checks that a kernel has a binding, a test, and a row in shaders/README.md."""
    name = path[len("shaders/"):-len(".comp")]
    folder, word = posixpath.split(name)
    has_tests = any(p.startswith(f"tests/{folder}/") for p in tree)
    for kind, prefix in (("binding", f"src/{folder}/"), ("test", f"tests/{folder}/" if has_tests else "tests/")):
        if not any(p.startswith(prefix) and p.endswith(".cpp") and
                   (has_word(t, word) or p.split("/")[-1].startswith(word)) for p, t in tree.items()):
            yield f"{path}:1: no {kind}: '{word}' is in no .cpp of {prefix}"
    if not has_word(tree.get("shaders/README.md", ""), name):
        yield f"{path}:1: no row '{name}' in shaders/README.md"


# ---- documents

class Known:
    """Names that exist in the source tree."""

    def __init__(self, tree):
        self.tree = tree
        self.folders = {str(p) for path in tree for p in pathlib.PurePosixPath(path).parents}
        self.top = {path.split("/")[0] for path in tree if "/" in path}
        config = self.find("src/run/config/", r'\bRELIDAR_SETTING\(\s*(\w+\.\w+)')
        weights = self.find("include/relidar/diff/loss_terms.h", r"\bTERM\(\d+u, \w+, (\w+),")
        self.settings = config | {"loss." + w for w in weights}
        self.sections = {s.split(".")[0] for s in self.settings}
        option = r'"(?:-\w,)?(--[a-z][\w-]*)'
        command = r'\bapp\.add_subcommand\(\s*"(\w+)"'
        self.commands = {"relidar": self.find("tools/relidar/", command),
                         "relidar-dev": self.find("tools/relidar_dev/", command)}
        self.options = {"relidar": self.find("tools/relidar/", option) | {"--help"}}
        self.options["relidar-dev"] = (self.find("tools/relidar_dev/", option) | {"--help"} |
                                       self.find("tools/relidar/options.cpp", option))

    def find(self, prefix, pattern):
        return {m for path, text in self.tree.items() if path.startswith(prefix) and path.endswith((".cpp", ".hpp", ".h"))
                for m in re.findall(pattern, text)}

    def has_path(self, name, anywhere=False):
        if name in self.tree or name in self.folders:
            return True
        if "*" not in name and not anywhere:
            return False
        pattern = re.compile("(.*/)?" + re.escape(name).replace(r"\*", "[^/]*"))
        return any(pattern.fullmatch(p) for p in [*self.tree, *self.folders])

    def has_name(self, prefix, word):
        return any(path.startswith(prefix) and not path.startswith("tests/structure/") and not path.endswith(".md")
                   and has_word(text, word) for path, text in self.tree.items())


def is_placeholder(name):
    file = name.split("/")[-1]
    return name in PLACEHOLDERS or (file not in ("README.md", "LICENSE") and
                                    re.search(r"<|>|\$|~|(^|/)[A-Z][A-Z0-9_]*(\.\w+)?(/|$)", name) is not None)


def expand_braces(name):
    match = re.fullmatch(r"([^{]*)\{([^}]*)\}(.*)", name)
    return [match[1] + choice + rest for choice in match[2].split(",") for rest in expand_braces(match[3])] \
        if match else [name]


def check_paths(known, path, text):
    """Yields the files, folders and kernels in `text` that do not exist."""
    for word in re.findall(r"[\w.*{},<>$~/+-]+", text):
        word = re.sub(r"^(<|\./)+|[.,/>]+$", "", word).removeprefix("relidar/") if "tools/" in word \
            else re.sub(r"^(<|\./)+|[.,/>]+$", "", word)
        if not word or word[0] == "/" or is_placeholder(word):
            continue
        for name in expand_braces(word):
            suffix = pathlib.PurePosixPath(name).suffix
            here = posixpath.normpath(posixpath.join(posixpath.dirname(path), name))
            if suffix in SOURCES:
                if not known.has_path(name, True) and not known.has_path(here):
                    yield "no file " + name
            elif name.split("/")[0] in known.top:
                if not known.has_path(name):
                    yield "no file or folder " + name
            elif "shaders/" + posixpath.dirname(name) in known.folders and "/" in name and not suffix:
                if not (known.has_path(f"shaders/{name}.comp") or known.has_path("src/" + name) or
                        known.has_name("src/", name) or known.has_name("tools/", name)):
                    yield "no kernel " + name


def check_command(known, words):
    """Yields commands and options of relidar and its scripts that do not exist."""
    program, script = "relidar", re.sub(r"^(\./|relidar/)", "", words[0])
    if script.startswith("tools/"):
        def has_option(option):
            return has_word(known.tree.get(script, ""), option[2:])
    elif words[0].startswith("--"):   # without a command, an option can belong to any program
        def has_option(option):
            return known.has_name("tools/", option[2:])
    else:
        def has_option(option):
            return option in known.options[program]
        called = [i for i, w in enumerate(words) if w.split("/")[-1] in known.commands]
        if called:
            program = words[called[0]].split("/")[-1]
            words = words[called[0] + 1:]
        elif words[0] not in known.commands["relidar"]:
            return
        if words and re.fullmatch("[a-z]+", words[0]) and words[0] not in known.commands[program]:
            yield f"no command {program} {words[0]}"
    for option in re.findall(r"(?<!\S)\[?(--[a-z][a-z0-9-]*)", " ".join(words)):
        if option not in known.options["relidar"] and not has_option(option):
            yield "no option " + option


def check_code(known, path, text, is_shell):
    yield from check_paths(known, path, text)
    for section, key in re.findall(r"(?<![\w/-])([a-z]+)\.([a-z][a-z0-9_]*)(?![\w(*.])", text):
        if section in known.sections and key not in FILE_ENDINGS and "." + key not in SOURCES \
                and f"{section}.{key}" not in known.settings:
            yield f"no setting {section}.{key}"
    for name in re.findall(r"\bRELIDAR_[A-Z0-9_]*[A-Z0-9]\b(?!\*)", text):
        if name not in PLACEHOLDERS and not known.has_name("", name):
            yield "no variable or option " + name
    for command in re.split(r"\s*(?:&&|\|\||[|;])\s*", text.split(" #")[0]) if is_shell else ():
        words = [w.lstrip("[") for w in command.split()]
        while words and "=" in words[0] and not words[0].startswith("--"):
            words.pop(0)
        if words:
            yield from check_command(known, words)


def make_anchor(heading):
    return re.sub(r"[^\w-]", "", heading.lower().replace(" ", "-"))


def split_document(text):
    """Yields (line, text, kind) with the kinds "shell", "other" (code) and "prose"."""
    def keep_lines(match):
        return "\n" * match[0].count("\n")
    for block in re.finditer(r"^```(\w*)\n(.*?)^```", text, re.S | re.M):
        first = text[:block.start(2)].count("\n") + 1
        joined = re.sub(r"\\\n", "  ", block[2])
        for line, code in enumerate(joined.split("\n"), first):
            yield line, code, "shell" if block[1] in ("", "sh", "bash") else "other"
    text = re.sub(r"^```.*?^```", keep_lines, text, flags=re.S | re.M)
    for span in re.finditer(r"`([^`\n]*(?:\n[^`\n]+)?)`", text):
        yield text[:span.start()].count("\n") + 1, span[1].replace("\n", " "), "shell"
    for line, prose in numbered(re.sub(r"`[^`\n]*(?:\n[^`\n]+)?`", keep_lines, text)):
        yield line, prose, "prose"


def check_documents(tree):
    known = Known(tree)
    anchors = {path: {make_anchor(h) for h in re.findall(r"^#+ +(.*)$", text.replace("`", ""), re.M)}
               for path, text in tree.items() if path.endswith(".md")}
    for path in anchors:
        if path == "docs/changelog.md":   # names what was removed
            continue
        for line, text, kind in split_document(tree[path]):
            if kind != "prose":
                wrong = list(check_code(known, path, text, kind == "shell"))
            else:
                wrong = list(check_paths(known, path, " ".join(re.findall(r"[\w/.-]+\.md\b", re.sub(r"\]\([^)]*\)", "]", text)))))
                for link in re.findall(r"\]\(([^)\s]*)\)", text):
                    target, _, anchor = link.partition("#")
                    file = posixpath.normpath(posixpath.join(posixpath.dirname(path), target)) if target else path
                    if "://" not in link and not known.has_path(file):
                        wrong.append("no file " + file)
                    elif "://" not in link and anchor and anchor not in anchors.get(file, ()):
                        wrong.append("no heading for " + link)
            yield from (f"{path}:{line}: {w}" for w in wrong)
    for path, text in tree.items():
        for line, comment in numbered(text) if ".md" in text and path not in anchors else ():
            if re.match(r"\s*(//|#).*\.md", comment):
                names = " ".join(re.findall(r"[\w/.-]+\.md\b", comment))
                yield from (f"{path}:{line}: {w}" for w in check_paths(known, path, names))
    blocks = re.findall(r"<!-- runnable -->\n```sh\n(.*?)```", tree.get("README.md", ""), re.S)
    for command in "".join(blocks).split("\n") if blocks else ["tools/missing"]:
        if command.startswith("tools/") and command.split()[0] not in tree:
            yield f"README.md:1: calls {command.split()[0]}, which does not exist"


def check_file_table(tree):
    """Compares the table of files at the end of architecture.md with the tree."""
    page = "docs/architecture.md"
    stems = {}
    for path in tree:
        folder, name = posixpath.split(path)
        if re.match("src/|tools/(relidar|view|serve|python)(/|$)", path) and name.endswith(FILE_TABLE_ENDINGS):
            stems.setdefault(folder, set()).add(name.rsplit(".", 1)[0])
    expected = {f"| `{folder}` | {', '.join(sorted(names))} |" for folder, names in stems.items()}
    rows = {row for row in tree[page].split("\n## 13. Files")[-1].split("\n") if row.startswith("| `")}
    yield from (f"{page}:1: section 13 has no row {row}" for row in sorted(expected - rows))
    yield from (f"{page}:1: section 13 has the wrong row {row}" for row in sorted(rows - expected))


# ---- names

def check_names(tree):
    for path, text in tree.items():
        if not path.endswith(CODE) or not path.startswith(("src/", "include/", "tools/", "shaders/")):
            continue
        for line, code in numbered(re.sub(r'//.*|"(?:[^"\\\n]|\\.)*"', "", text)):
            for name in re.findall(FUNCTION, code):
                if len(name) > MAX_NAME or re.search("_and_get_|_or_throw|^try_to_", name):
                    yield f"{path}:{line}: the function name {name} is too long, at most {MAX_NAME}"
            space = re.match(r"namespace relidar::(\w+)", code)
            if space and not set(SPACES.get(space[1], (space[1],))) & set(path.split("/")):
                yield f"{path}:{line}: the namespace {space[1]} is no folder of the path"


RULES = (check_includes, check_folders, check_umbrella, check_files, check_names, check_documents, check_file_table)

# A fault for each rule: the file, the text that is added, and a part of the violation.
FAULTS = [
    ("src/base/files.hpp", "#include <relidar/log/sensor.hpp>\n", "base may not include log"),
    ("src/read/datasets/once/once.cpp", '#include "read/datasets/waymo/waymo_frame.hpp"\n', "readers do not include"),
    ("include/relidar/log/sensor.hpp", '#include "base/files.hpp"\n', "only public headers"),
    ("src/run/edit/edit.cpp", '#include "scene/visibility.hpp"\n', "only through its public headers"),
    ("src/log/sensor/rays.cpp", "#include <volk.h>\n", "<volk.h> is not allowed here"),
    ("tools/view/view.cpp", '#include "base/files.hpp"\n', "tools see only include/relidar"),
    ("src/base/files.hpp", '#include "base/files.hpp"\n', "a cycle"),
    ("src/read/files/file_order.cpp", '#include "read/scans/scan_plan.hpp"\n', "a circle of folders"),
    (UMBRELLA, "#include <relidar/diff/forward.hpp>\n", "must not include"),
    ("src/base/new.cpp", "int x;\n", "no SPDX"),
    ("src/base/files.hpp", "\n" * 600, "lines, at most"),
    ("src/base/files.hpp", "// " + 99 * "x" + "\n", "columns, at most"),
    ("src/log/sensor/rays.cpp", "VkDevice device;\n", "outside src/gpu"),
    ("tests/base/lost_test.cpp", "", "no CMakeLists.txt contains"),
    ("shaders/diff/loss/lost.comp", "", "no binding"),
    ("src/log/sensor/rays.cpp", "int find_the_beam_of_a_ring_and_throw();\n", "is too long"),
    ("src/log/sensor/rays.cpp", "namespace relidar::lost {}\n", "no folder of the path"),
    ("docs/guide.md", "`src/lost.cpp`\n", "no file src/lost.cpp"),
    ("docs/guide.md", "`train.lost`\n", "no setting train.lost"),
    ("docs/guide.md", "`relidar lost run`\n", "no command relidar lost"),
    ("docs/guide.md", "`relidar render run --lost`\n", "no option --lost"),
    ("docs/guide.md", "`RELIDAR_LOST`\n", "no variable or option RELIDAR_LOST"),
    ("docs/guide.md", "[x](sensors.md#lost)\n", "no heading for sensors.md#lost"),
    ("docs/guide.md", "[x](lost.md)\n", "no file docs/lost.md"),
    ("docs/architecture.md", "| `src/lost` | lost |\n", "the wrong row"),
    ("README.md", "<!-- runnable -->\n```sh\ntools/lost\n```\n", "calls tools/lost"),
]


def main():
    tree = read_tree()
    violations = [v for rule in RULES for v in rule(tree)]
    if "--faults" in sys.argv:
        for path, text, _ in FAULTS:
            tree[path] = tree.get(path, "") + text
        found = [v for rule in RULES for v in rule(tree)]
        violations += [f"{path}:1: no rule finds {text!r:.60}, expected '{message}'" for path, text, message in FAULTS
                       if not any(v.startswith(path) and message in v for v in found)]
    print("\n".join(violations) if violations else f"{len(tree)} files, no violations")
    return bool(violations)


if __name__ == "__main__":
    sys.exit(main())
