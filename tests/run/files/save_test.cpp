// SPDX-License-Identifier: Apache-2.0
// An earlier run in the same folder must remain until the new run is written.
#include <relidar/run/run.hpp>

#include <gmock/gmock.h>

#include "../../support/file_size_limit.hpp"
#include "saved_run.hpp"

namespace relidar {
namespace {

TEST_F(SavedRun, IsSavedCompleteOrNotAtAll) {
    const std::string model = read_contents(run.folder / kModelFile);
    relidar::Run grown = run;
    grown.drop_network = make_example_network();
    for (rlim_t n_bytes = 0; n_bytes < 40'000; n_bytes += 5'000) {
        const test::FileSizeLimit full(n_bytes);
        for (const char* name : {"new", "run"}) {
            grown.folder = folder / name;
            try {
                save_run(grown);
                EXPECT_FALSE(load_run(grown.folder).drop_network.empty());
            } catch (const DataError& error) {
                EXPECT_THAT(error.what(), testing::HasSubstr(grown.folder.string() + "/"));
                EXPECT_THAT(error.what(), testing::Not(testing::HasSubstr(".tmp-")));
                EXPECT_FALSE(std::filesystem::exists(folder / "new"));
                EXPECT_EQ(read_contents(run.folder / "scene.json"), scene);
                EXPECT_EQ(read_contents(run.folder / kModelFile), model);
            }
        }
        std::filesystem::remove_all(folder / "new");
    }
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder))
        EXPECT_EQ(entry.path().string().find(".tmp-"), std::string::npos) << entry.path();
}

TEST_F(SavedRun, GivesItsFilesTheirNamesWhenAllAreWritten) {
    bool was_called = false;
    overwrite_run(run, [&] {
        was_called = true;
        EXPECT_FALSE(std::filesystem::exists(run.folder / "config.toml"))
            << "a process that is killed here leaves what looks like a run";
        EXPECT_TRUE(std::filesystem::exists(run.folder / kModelFile));
    });
    EXPECT_TRUE(was_called);
    EXPECT_EQ(read_contents(load_run(run.folder).folder / "scene.json"), scene);
}

}  // namespace
}  // namespace relidar
