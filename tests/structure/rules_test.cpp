// SPDX-License-Identifier: Apache-2.0
// Tests that each rule of rules.hpp detects its violations. Uses small source trees with
// a single violation each.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "../support/names.hpp"
#include "rules.hpp"

namespace relidar::structure {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

SourceTree make_tree(const std::map<std::string, std::string>& files) {
    SourceTree tree;
    for (const auto& [path, text] : files) tree.emplace(path, make_file(path, text));
    return tree;
}

TEST(Reader, BlanksCommentsAndLiterals) {
    EXPECT_EQ(blank_comments_and_literals("a // b\nc"), "a     \nc");
    EXPECT_EQ(blank_comments_and_literals("x = \"{ // \"; y"), "x =        ; y");
    EXPECT_EQ(blank_comments_and_literals("/* {\n */z"), "    \n   z");
    EXPECT_EQ(blank_comments_and_literals("R\"js(\" } )js\" + '{' + 1'000"), "              +     + 1'000");
}

TEST(Reader, FindsFunctions) {
    const SourceFile file = make_file("a.cpp",
                                      "namespace n {\n"
                                      "struct S {\n"
                                      "public:\n"
                                      "    S(int a, int b) : a_(a), b_{b} {\n"
                                      "    }\n"
                                      "    int a_ = 0;\n"
                                      "    bool operator==(const S&) const;\n"
                                      "};\n"
                                      "const int table[] = {1, 2};\n"
                                      "template <class T>\n"
                                      "T f(std::map<int, T> m,\n"
                                      "    T x = {}) {\n"
                                      "    if (x) { return m(x, 1); }\n"
                                      "    return x;\n"
                                      "}\n"
                                      "void g();\n"
                                      "}\n");
    const std::vector<Function> functions = list_functions(file);
    ASSERT_EQ(functions.size(), 4u);
    EXPECT_EQ(functions[0].name, "S");
    EXPECT_EQ(functions[0].scope, "S");
    EXPECT_EQ(functions[0].n_arguments, 2);
    EXPECT_EQ(functions[0].first_line, 4);
    EXPECT_EQ(functions[1].name, "operator==");
    EXPECT_EQ(functions[2].name, "f");
    EXPECT_EQ(functions[2].n_arguments, 2);
    EXPECT_EQ(functions[2].first_line, 10);
    EXPECT_EQ(functions[2].n_lines(), 6);
    EXPECT_EQ(functions[3].name, "g");
    EXPECT_EQ(functions[3].n_arguments, 0);
    EXPECT_FALSE(functions[3].has_body);
}

TEST(Rules, IncludeUpwardsIsFound) {
    const SourceTree tree =
        make_tree({{"include/relidar/log/sensor.hpp", "#include <relidar/scene/scene.hpp>\n"},
                   {"include/relidar/scene/scene.hpp", ""},
                   {"shaders/gpu/a.glsl", "#include \"../diff/b.glsl\"\n"},
                   {"shaders/diff/b.glsl", ""},
                   {"src/other/c.cpp", "#include <relidar/log/sensor.hpp>\n"}});
    EXPECT_THAT(check_include_edges(tree),
                ElementsAre(test::Names("scene.hpp: log ... scene"), test::Names("b.glsl: gpu ... diff"),
                            test::Names("src/other/c.cpp ... rooms")));
}

TEST(Rules, IncludePastPublicHeadersIsFound) {
    const SourceTree tree = make_tree({{"src/diff/forward/a.cpp", "#include \"scene/sorted.hpp\"\n"},
                                       {"src/scene/sorted.hpp", ""},
                                       {"include/relidar/diff/a.hpp", "#include \"scene/sorted.hpp\"\n"}});
    EXPECT_THAT(check_include_edges(tree),
                ElementsAre(test::Names("include/relidar/diff/a.hpp:1 ... public"),
                            test::Names("src/diff/forward/a.cpp:1 ... <relidar/scene/...>")));
}

TEST(Rules, IncludeBetweenReadersIsFound) {
    const SourceTree tree =
        make_tree({{"src/log/readers/once/a.cpp", "#include \"log/readers/bag/b.hpp\"\n"},
                   {"src/log/readers/bag/b.hpp", ""},
                   {"src/log/readers/registry.cpp", "#include \"log/readers/bag/b.hpp\"\n"}});
    EXPECT_THAT(check_include_edges(tree), ElementsAre(HasSubstr("once/a.cpp:1")));
}

TEST(Rules, InfrastructureMayBeIncludedDirectly) {
    const SourceTree tree = make_tree(
        {{"src/diff/forward/a.cpp", "#include \"gpu/stream.hpp\"\n#include \"diff/shared/forward.h\"\n"},
         {"src/gpu/stream.hpp", ""},
         {"shaders/diff/shared/forward.h", ""}});
    EXPECT_THAT(check_include_edges(tree), IsEmpty());
}

TEST(Rules, LibraryOutsideItsFolderIsFound) {
    const SourceTree tree = make_tree(
        {{"src/base/codecs/a.cpp", "#include <png.h>\n"}, {"src/simulate/b.cpp", "#include <png.h>\n"}});
    EXPECT_THAT(check_library_headers(tree), ElementsAre(HasSubstr("src/simulate/b.cpp:1: <png.h>")));
}

TEST(Rules, ReferenceAndShadersAndToolsKeepApart) {
    const SourceTree tree = make_tree({{"tests/reference/a.cpp", "#include \"diff/shared/forward.h\"\n"},
                                       {"tests/reference/b.cpp", "#include <relidar/diff/rays.h>\n"},
                                       {"tools/relidar/a.cpp", "#include \"../../src/base/log.hpp\"\n"},
                                       {"src/base/c.cpp", "#include \"support/d.hpp\"\n"},
                                       {"tests/support/d.hpp", ""},
                                       {"include/relidar/diff/rays.h", ""},
                                       {"shaders/diff/shared/forward.h", ""},
                                       {"src/base/log.hpp", ""}});
    EXPECT_EQ(check_include_edges(tree).size(), 4u);
}

TEST(Rules, ReferenceTestsMayUseTestSupport) {
    const SourceTree tree = make_tree({{"tests/reference/a_test.cpp", "#include \"support/b.hpp\"\n"},
                                       {"tests/reference/a.cpp", "#include \"support/b.hpp\"\n"},
                                       {"tests/support/b.hpp", ""}});
    EXPECT_THAT(check_include_edges(tree), ElementsAre(HasSubstr("tests/reference/a.cpp:1")));
}

TEST(Rules, CycleIsFound) {
    const SourceTree tree =
        make_tree({{"src/gpu/a.hpp", "#include \"b.hpp\"\n"}, {"src/gpu/b.hpp", "#include \"a.hpp\"\n"}});
    EXPECT_THAT(check_include_chains(tree), ElementsAre(HasSubstr("cycle")));
}

TEST(Rules, LongChainIsFound) {
    std::map<std::string, std::string> files;
    for (int i = 0; i < 9; ++i)
        files["src/gpu/f" + std::to_string(i) + ".hpp"] = "#include \"f" + std::to_string(i + 1) + ".hpp\"\n";
    EXPECT_THAT(check_include_chains(make_tree(files)), ElementsAre(test::Names("chain ... 9")));
}

TEST(Rules, KernelWithoutCompanyIsFound) {
    EXPECT_EQ(check_kernels(make_tree({{"shaders/loss/bce.comp", ""}})).size(), 3u);
    const SourceTree bound_elsewhere =
        make_tree({{"shaders/loss/bce.comp", ""}, {"src/forward/a.cpp", "bce"}, {"tests/a.cpp", "bce"}});
    EXPECT_THAT(check_kernels(bound_elsewhere), ElementsAre(test::Names("binding"), test::Names("row")));
    const SourceTree complete = make_tree({{"shaders/diff/loss/bce.comp", ""},
                                           {"shaders/README.md", "| diff/loss/bce | cross-entropy |"},
                                           {"src/diff/loss/loss.cpp", "run(bce)"},
                                           {"tests/diff/loss/bce_test.cpp", ""}});
    EXPECT_THAT(check_kernels(complete), IsEmpty());
}

TEST(Rules, TwoBarePointersOfOneKindAreFound) {
    const SourceTree tree =
        make_tree({{"shaders/diff/shared/a.h",
                    "struct P {\n    Floats x;   // input\n    Uints n;\n    Floats y;\n};\n"
                    "struct Q {\n    Floats z;\n    RELIDAR_OF(Floats, Tangents) t;\n};\n"}});
    EXPECT_THAT(check_bare_pointers(tree), ElementsAre(test::Names("a.h:4: P::y ... x")));
}

TEST(Rules, QuestionForAPrimitiveIsFound) {
    const SourceTree tree =
        make_tree({{"src/edit/a.cpp",
                    "PrimitiveType p = PrimitiveType::surfel;\nif (p == PrimitiveType::gaussian) f();\n"},
                   {"tools/relidar/b.cpp", "return s.log_scale_w.empty();\n"},
                   {"src/edit/c.cpp", "if (get_primitive_properties(p).has_normals) f();\n"},
                   {"tests/edit/d.cpp", "EXPECT_TRUE(p == PrimitiveType::gaussian);\n"}});
    EXPECT_THAT(check_primitive_questions(tree), ElementsAre(HasSubstr("a.cpp:2:"), HasSubstr("b.cpp:1:")));
}

TEST(Rules, BudgetsAreCounted) {
    std::string body;
    for (int i = 0; i < 60; ++i) body += "    step();\n";
    const SourceTree tree = make_tree(
        {{"src/core/long_function.cpp", "void f() {\n" + body + "}\n"},
         {"src/core/many.cpp", "void g(int a, int b, int c, int d, int e, int f, int g, int h) {}\n"},
         {"shaders/loss/long.comp", std::string(221, '\n')},
         {"src/core/wide.hpp", "//" + std::string(89, '-') + "\nint " + std::string(110, 'a') + ";\n// " +
                                   std::string(87, '-') + "\nint " + std::string(105, 'a') +
                                   ";\n///   x = " + std::string(90, 'y') + "\nconst char* s = \"" +
                                   std::string(200, 'x') + "\";\n"}});
    EXPECT_EQ(check_budgets(tree).size(), 5u);
}

TEST(Rules, FileNameInTwoRoomsIsFound) {
    const SourceTree tree = make_tree({{"src/gpu/describe.cpp", ""},
                                       {"src/log/readers/describe.cpp", ""},
                                       {"src/log/describe.hpp", ""},
                                       {"tests/gpu/describe.cpp", ""}});
    EXPECT_THAT(check_file_names(tree), ElementsAre(HasSubstr("src/log/readers/describe.cpp:1")));
}

TEST(Rules, VulkanNameIsFound) {
    const SourceTree tree =
        make_tree({{"src/forward/a.cpp", "// VkBuffer\nVkBuffer b;\n"}, {"src/gpu/a.cpp", "VkBuffer b;\n"}});
    EXPECT_THAT(check_vulkan_names(tree), ElementsAre(HasSubstr("a.cpp:2: VkBuffer")));
}

TEST(Rules, CommaStatementIsFound) {
    const SourceTree tree = make_tree({{"src/a.cpp",
                                        "void f() {\n"
                                        "    int a = 1, b = 2;\n"
                                        "    for (a = 0, b = 1; a < b; ++a, --b) g(a, b);\n"
                                        "    const auto c = h<int, float>(a, {b, a});\n"
                                        "    c = h<int, float>(a, b);\n"
                                        "    a = 1, b = 2;\n"
                                        "    if (a < b) a = b, ++b;\n"
                                        "    g(a), b = 3;\n"
                                        "    return g(b), a;\n"
                                        "}\n"}});
    EXPECT_THAT(check_comma_statements(tree), ElementsAre(HasSubstr("a.cpp:6:"), HasSubstr("a.cpp:7:"),
                                                          HasSubstr("a.cpp:8:"), HasSubstr("a.cpp:9:")));
}

TEST(Rules, NestedConditionalIsFound) {
    const SourceTree tree = make_tree({{"src/a.cpp",
                                        "int a = x ? 1 : 2, b = y ? 1 : 2;\n"
                                        "f(x ? 1 : 2, y ? 1 : 2, \"? :\");\n"
                                        "int c = x ? g(y ? 1 : 2) : 3;\n"
                                        "int d = x ? 1 : y ? 2 : 3;\n"
                                        "int e = x ? 1 : (y ? 2 : 3);\n"}});
    EXPECT_THAT(check_nested_conditionals(tree), ElementsAre(HasSubstr("a.cpp:4:"), HasSubstr("a.cpp:5:")));
}

TEST(Rules, UncommentedFunctionIsFound) {
    const SourceTree tree =
        make_tree({{"include/relidar/a.hpp",
                    "/// Does.\nint f(int x);\nint g(int x);\n\nint h(int x);\nint k;  ///< a count\n"}});
    EXPECT_THAT(check_face_comments(tree), ElementsAre(HasSubstr("a.hpp:5: h")));
}

TEST(Rules, TestFileWithoutASuiteIsFound) {
    const SourceTree tree = make_tree({{"tests/CMakeLists.txt", "relidar_test(gpu gpu a_test.cpp)\n"},
                                       {"tests/gpu/a_test.cpp", ""},
                                       {"tests/gpu/b_test.cpp", ""}});
    EXPECT_THAT(check_test_suites(tree), ElementsAre(HasSubstr("tests/gpu/b_test.cpp:1")));
}

TEST(Rules, MissingLicenceIsFound) {
    const SourceTree tree = make_tree({{"a.cpp", "int x;\n"}, {"tools/go", "#!/bin/sh\n"}, {"notes.md", ""}});
    EXPECT_EQ(check_licence_lines(tree).size(), 2u);
}

TEST(Rules, MirrorIsFound) {
    const std::string host = std::string("deb.") + "debian.org";
    EXPECT_THAT(check_mirror_names(make_tree({{"tools/go", "x http://" + host + "/y\n"}})),
                ElementsAre(HasSubstr(host)));
}

TEST(Rules, ReadmeCallingNothingIsFound) {
    const std::string block = "<!-- runnable -->\n```sh\ntools/demo\n```\n";
    EXPECT_THAT(check_readme(make_tree({{"README.md", block}})), ElementsAre(HasSubstr("README.md:3")));
    EXPECT_THAT(check_readme(make_tree({{"README.md", block}, {"tools/demo", ""}})), IsEmpty());
    EXPECT_THAT(check_readme(make_tree({{"README.md", "text"}})), ElementsAre(test::Names("block")));
    EXPECT_THAT(check_readme({}), ElementsAre(HasSubstr("missing")));
}

/// Returns the violations that the rules report for a document in a small checkout.
Violations check_document(const std::string& document) {
    return check_documents(
        make_tree({{"docs/a.md", document},
                   {"docs/b.md", "# Two words, and `code`\n"},
                   {"README.md", ""},
                   {"src/run/config/fields.hpp", "visitor(\"train.iterations\", c.n);"},
                   {"include/relidar/diff/loss_terms.h", "TERM(0u, ssim, intensity_ssim, 0.1f)"},
                   {"shaders/loss/bce.comp", ""},
                   {"tools/bench/card.sh", "case $1 in --quick) ;; esac"},
                   {"tools/relidar/train.cpp",
                    "app.add_subcommand(\"train\", x); add(\"--out\"); getenv(\"RELIDAR_X\")"},
                   {"tools/relidar_dev/a.cpp", "app.add_subcommand(\"bench\", x); add(\"--slow\")"}}));
}

TEST(Documents, NamesThatExistAreRight) {
    EXPECT_THAT(check_document("See [b](b.md#two-words-and-code), [here](../README.md), b.md and "
                               "`src/run/config/fields.{hpp,h}`\n")
                    .size(),
                1u);
    EXPECT_THAT(check_document("`train.iterations=3`, `loss.intensity_ssim`, `loss.*`, `train.csv`, "
                               "`config.train.iterations`\n"),
                IsEmpty());
    EXPECT_THAT(check_document("`relidar train LOG --out\nrun`, `tools/bench/card.sh --quick`, `loss/bce`, "
                               "`<relidar/diff/loss_terms.h>`\n"),
                IsEmpty());
    EXPECT_THAT(check_document("```sh\nmpirun --np 2 relidar train LOG \\\n  --out run   # --like "
                               "this\nRELIDAR_X=1 cmake --build x\n```\n"),
                IsEmpty());
    EXPECT_THAT(check_document("`src/<kind>/*.cpp`, `RUN/a.cpp`, `shaders/*/*.comp`\n"), IsEmpty());
}

TEST(Documents, EachProgramHasItsOwnCommandsAndOptions) {
    EXPECT_THAT(check_document("`relidar-dev bench --slow`, `build/relidar-dev bench`\n"), IsEmpty());
    EXPECT_THAT(
        check_document(
            "`relidar bench`, `relidar-dev train`, `relidar train --slow`, `relidar-dev bench --like`\n"),
        ElementsAre(test::Names("command relidar bench"), test::Names("command relidar-dev train"),
                    HasSubstr("option --slow"), HasSubstr("option --like")));
}

TEST(Documents, NamesThatDoNotExistAreFound) {
    EXPECT_THAT(check_document("\n[b](c.md) [b](b.md#three)\n"),
                ElementsAre(test::Names("docs/a.md:2 ... docs/c.md"), test::Names("heading ... b.md#three")));
    EXPECT_THAT(check_document("see formats.md, `src/conf`, `config.hpp`\n").size(), 3u);
    EXPECT_THAT(check_document("`loss/mse` and `shaders/*/mse.comp`\n"),
                ElementsAre(test::Names("kernel loss/mse"), test::Names("file shaders/*/mse.comp")));
    EXPECT_THAT(check_document("`train.steps`, `loss.ssim`, `loss.x=0`\n").size(), 3u);
    EXPECT_THAT(check_document("```sh\nx && relidar run\nrelidar train --in LOG \\\n--outs run\n```\n"),
                ElementsAre(test::Names("a.md:2 ... command relidar run"), test::Names("a.md:3 ... --in"),
                            HasSubstr("--outs")));
    EXPECT_THAT(check_document(
                    "`train --outs`, `--in`, `tools/bench/card.sh --slow`, `relidar_bench_x`, `RELIDAR_Y`\n")
                    .size(),
                5u);
    EXPECT_THAT(
        check_documents(make_tree({{"a.md", ""}, {"src/a.cpp", "int a;\n/// as b.md and a.md say\n"}})),
        ElementsAre(test::Names("src/a.cpp:2 ... b.md"), test::Names("settings ... commands")));
}

TEST(Umbrella, IncludesNoTrainerHeaderThroughOthers) {
    const SourceTree tree =
        make_tree({{"include/relidar/relidar.hpp", "#include <relidar/run/config.hpp>\n"},
                   {"include/relidar/run/config.hpp", "#include <relidar/diff/loss_options.hpp>\n"},
                   {"include/relidar/diff/loss_options.hpp",
                    "#include <relidar/diff/loss_terms.h>\n#include <relidar/gpu/stream.hpp>\n"},
                   {"include/relidar/diff/loss_terms.h", ""},
                   {"include/relidar/gpu/stream.hpp", ""}});
    EXPECT_THAT(check_umbrella(tree),
                ElementsAre(test::Names("loss_options.hpp:2 ... include/relidar/gpu/stream.hpp")));
}

TEST(InstalledNames, OfSourcesAreFound) {
    const SourceTree tree = make_tree(
        {{"include/relidar/a.hpp", "// docs/method.md, relidar/b.hpp\n// src/a.cpp\n// docs/gone.md\n"},
         {"include/relidar/b.hpp", ""},
         {"src/a.cpp", ""},
         {"docs/method.md", ""}});
    EXPECT_THAT(check_installed_names(tree),
                ElementsAre(test::Names("a.hpp:2 ... src/a.cpp"), test::Names("a.hpp:3 ... docs/gone.md")));
}

}  // namespace
}  // namespace relidar::structure
