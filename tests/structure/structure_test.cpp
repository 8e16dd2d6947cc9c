// SPDX-License-Identifier: Apache-2.0
// Tests that the source tree of this checkout satisfies the rules of rules.hpp.
#include <gtest/gtest.h>

#include "rules.hpp"

namespace relidar::structure {
namespace {

const SourceTree& checkout() {
    static const SourceTree tree = read_tree(RELIDAR_SOURCE_DIR);
    return tree;
}

void expect_none(const Violations& violations) {
    for (const std::string& violation : violations) ADD_FAILURE() << violation;
}

TEST(Structure, IncludesFollowTheRooms) { expect_none(check_include_edges(checkout())); }
TEST(Structure, IncludeChainsAreShortAndAcyclic) { expect_none(check_include_chains(checkout())); }
TEST(Structure, LibrariesAreUsedInTheirFolders) { expect_none(check_library_headers(checkout())); }
TEST(Structure, TheUmbrellaIncludesNoTrainerHeaders) { expect_none(check_umbrella(checkout())); }
TEST(Structure, InstalledHeadersNameInstalledFiles) { expect_none(check_installed_names(checkout())); }
TEST(Structure, KernelsHaveBindingTestAndRow) { expect_none(check_kernels(checkout())); }
TEST(Structure, PointersSayWhatTheyHold) { expect_none(check_bare_pointers(checkout())); }
TEST(Structure, PrimitivesAreAskedByTheirRow) { expect_none(check_primitive_questions(checkout())); }
TEST(Structure, BudgetsAreKept) { expect_none(check_budgets(checkout())); }
TEST(Structure, FileNamesTellRoomsApart) { expect_none(check_file_names(checkout())); }
TEST(Structure, VulkanStaysInGpuAndAccel) { expect_none(check_vulkan_names(checkout())); }
TEST(Structure, AStatementDoesOneThing) { expect_none(check_comma_statements(checkout())); }
TEST(Structure, ConditionalsAreNotNested) { expect_none(check_nested_conditionals(checkout())); }
TEST(Structure, FacesAreCommented) { expect_none(check_face_comments(checkout())); }
TEST(Structure, TestFilesAreCompiled) { expect_none(check_test_suites(checkout())); }
TEST(Structure, LicenceIsNamed) { expect_none(check_licence_lines(checkout())); }
TEST(Structure, NoMirrorIsNamed) { expect_none(check_mirror_names(checkout())); }
TEST(Structure, ReadmeCommandsExist) { expect_none(check_readme(checkout())); }
TEST(Structure, WhatDocumentsNameExists) { expect_none(check_documents(checkout())); }

TEST(Structure, CheckoutWasRead) {
    EXPECT_TRUE(checkout().contains("LICENSE"));
    EXPECT_TRUE(checkout().contains("include/relidar/log/sensor.hpp"));
    EXPECT_FALSE(list_functions(checkout().at("include/relidar/log/sensor.hpp")).empty());
}

}  // namespace
}  // namespace relidar::structure
