// SPDX-License-Identifier: Apache-2.0
// Tests that a run folder is created completely or not at all. An earlier run in the same
// folder must remain until the new run is written.
#include <relidar/run/run.hpp>

#include <csignal>

#include <sys/resource.h>

#include <gmock/gmock.h>

#include "saved_run.hpp"

namespace relidar {
namespace {

/// Simulates a full disk while the object exists: files of this process cannot grow.
class FullDisk {
public:
    explicit FullDisk(rlim_t n_bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
        ::getrlimit(RLIMIT_FSIZE, &before_);
        const rlimit limit{n_bytes, before_.rlim_max};
        ::setrlimit(RLIMIT_FSIZE, &limit);
    }
    ~FullDisk() {
        ::setrlimit(RLIMIT_FSIZE, &before_);
        std::signal(SIGXFSZ, handler_);
    }
    FullDisk(const FullDisk&) = delete;
    FullDisk& operator=(const FullDisk&) = delete;

private:
    rlimit before_{};
    void (*handler_)(int);
};

TEST_F(SavedRun, IsSavedCompleteOrNotAtAll) {
    const std::string model = read_contents(run.folder / kModelFile);
    relidar::TrainedRun grown = run;
    RayDropNetwork& network = grown.drop_network;
    network.image = "kitti360";
    network.inputs = {"log_range", "intensity", "drop_logit"};
    network.widths = {4, 8};
    network.heads = 2;
    network.residual = false;
    network.normalisation = {0.5f, -2.0f, 1.0f, 0.0f, 5.0f, 6.0f};
    network.parameters.assign(1000, 0.25f);
    network.running = {0.1f, 0.2f};
    for (rlim_t n_bytes = 0; n_bytes < 40'000; n_bytes += 5'000) {
        const FullDisk full(n_bytes);
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
