// SPDX-License-Identifier: Apache-2.0
// After an error, no temporary file may remain, and the target must be unchanged.
#include <relidar/base/arrays.hpp>
#include <relidar/score/report.hpp>
#include <relidar/simulate/point_files.hpp>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fmt/format.h>
#include <gmock/gmock.h>

#include "support/file_size_limit.hpp"
#include "temporary_folder.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using AtomicFile = TemporaryFolder;

TEST_F(AtomicFile, WritesAndReplaces) {
    write_text_file(folder / "a.txt", "first");
    write_text_file(folder / "a.txt", "second, longer");
    EXPECT_EQ(read_contents(folder / "a.txt"), "second, longer");
    write_text_file(folder / "a.txt", "");
    EXPECT_EQ(read_contents(folder / "a.txt"), "");
    EXPECT_EQ(files(), std::vector<std::string>{"a.txt"});
}

TEST_F(AtomicFile, WritesRelativePathsWithoutFolder) {
    const fs::path before = fs::current_path();
    fs::current_path(folder);
    write_text_file("plain.txt", "here");
    fs::current_path(before);
    EXPECT_EQ(read_contents(folder / "plain.txt"), "here");
}

TEST_F(AtomicFile, KeepsOldFileWhereTheWriterThrows) {
    put(folder / "a.txt", "old");
    const std::string message = get_data_error_message([&] {
        write_atomically(folder / "a.txt", [](const fs::path& temporary) {
            put(temporary, "half");
            throw std::runtime_error("line one\nline two");
        });
    });
    EXPECT_THAT(message,
                testing::AllOf(testing::HasSubstr("a.txt"), testing::HasSubstr("line one line two")));
    EXPECT_EQ(read_contents(folder / "a.txt"), "old");
    EXPECT_EQ(files(), std::vector<std::string>{"a.txt"});
}

TEST_F(AtomicFile, LetsDeviceErrorsThrough) {
    const auto lose_device = [](const fs::path& temporary) {
        put(temporary, "half");
        throw DeviceError("device lost");
    };
    EXPECT_THROW(write_atomically(folder / "a.bin", lose_device), DeviceError);
    EXPECT_TRUE(files().empty());
}

TEST_F(AtomicFile, RefusesAWriterThatWritesNothing) {
    get_data_error_message([&] { write_atomically(folder / "a.bin", [](const fs::path&) {}); });
    EXPECT_TRUE(files().empty());
}

TEST_F(AtomicFile, NamesAMissingFolder) {
    const std::string message =
        get_data_error_message([&] { write_text_file(folder / "none" / "a.txt", "x"); });
    EXPECT_THAT(message,
                testing::AllOf(testing::HasSubstr("none'"), testing::HasSubstr("No such file or directory")));
    EXPECT_FALSE(fs::exists(folder / "none"));
}

TEST_F(AtomicFile, RefusesFoldersAndDevices) {
    fs::create_directory(folder / "sub");
    get_data_error_message([&] { write_text_file(folder / "sub", "x"); });
    get_data_error_message([&] { write_text_file(folder / "sub/", "x"); });
    get_data_error_message([&] { write_text_file("/dev/null", "x"); });
    put(folder / "file", "");
    get_data_error_message([&] { write_text_file(folder / "file" / "a.txt", "x"); });
    EXPECT_TRUE(fs::is_character_file("/dev/null"));
    EXPECT_EQ(files().size(), 2u);
}

TEST_F(AtomicFile, WritesThroughALink) {
    put(folder / "target.txt", "old");
    fs::create_symlink("target.txt", folder / "link.txt");
    write_text_file(folder / "link.txt", "new");
    EXPECT_TRUE(fs::is_symlink(folder / "link.txt"));
    EXPECT_EQ(read_contents(folder / "target.txt"), "new");
}

TEST_F(AtomicFile, NamesAFolderThatCannotBeWritten) {
    if (::geteuid() == 0) GTEST_SKIP() << "root may write everywhere";
    fs::permissions(folder, fs::perms::owner_read | fs::perms::owner_exec);
    const std::string message = get_data_error_message([&] { write_text_file(folder / "a.txt", "x"); });
    fs::permissions(folder, fs::perms::owner_all);
    EXPECT_NE(message.find("Permission denied"), std::string::npos) << message;
    EXPECT_TRUE(files().empty());
}

TEST_F(AtomicFile, NamesAFileSystemThatCannotBeWritten) {
    if (!fs::is_directory("/proc/self")) GTEST_SKIP() << "no /proc";
    // not writable for root either
    const std::string message = get_data_error_message([&] { write_text_file("/proc/relidar.txt", "x"); });
    EXPECT_NE(message.find("/proc/relidar.txt"), std::string::npos) << message;
}

TEST_F(AtomicFile, LeftoversOfAKilledProcessAreRemoved) {
    for (const char* name : {".a.txt.tmp-123-0", ".iteration_00000400.safetensors.tmp-9-17"})
        put(folder / name, "half");
    for (const char* name : {"a.txt", ".a.txt.tmp-123", "a.txt.tmp-1-1", ".hidden", ".a.tmp-1-1.txt"})
        put(folder / name, "somebody's");
    remove_temp(folder);
    remove_temp(folder / "nowhere");
    EXPECT_EQ(files().size(), 5u);
    pid_t child = ::fork();  // uses real leftovers of a killed process
    if (child == 0)
        write_atomically(folder / "b.txt", [](const fs::path& temporary) {
            put(temporary, "half");
            ::_exit(0);
        });
    ::waitpid(child, nullptr, 0);
    EXPECT_EQ(files().size(), 6u);
    remove_temp(folder);
    EXPECT_EQ(files().size(), 5u);
}

using StagedFolders = TemporaryFolder;

TEST_F(StagedFolders, AppearWhenTheyAreFinished) {
    {
        const StagedFolder staged(folder / "log" / "");
        write_text_file(staged.path() / "a.txt", "first");
        EXPECT_FALSE(fs::exists(folder / "log"));
        staged.replace_folder();
    }
    EXPECT_EQ(read_contents(folder / "log/a.txt"), "first");
    {
        const StagedFolder staged(folder / "log");
        write_text_file(staged.path() / "b.txt", "second");
        EXPECT_EQ(read_contents(folder / "log/a.txt"), "first");
        staged.replace_folder();
    }
    EXPECT_EQ(read_contents(folder / "log/b.txt"), "second");
    EXPECT_FALSE(fs::exists(folder / "log/a.txt")) << "the new one is in the place of the old one";
    EXPECT_EQ(files(), std::vector<std::string>{"log"});
}

TEST_F(StagedFolders, LeaveNothingWhereTheyAreNotFinished) {
    fs::create_directory(folder / "log");
    put(folder / "log/a.txt", "first");
    {
        const StagedFolder staged(folder / "log");
        write_text_file(staged.path() / "b.txt", "second");
    }
    EXPECT_EQ(files(), std::vector<std::string>{"log"});
    EXPECT_EQ(read_contents(folder / "log/a.txt"), "first");
    put(folder / "file", "");
    EXPECT_THROW(StagedFolder(folder / "file" / "log"), DataError);
}

TEST_F(StagedFolders, OfKilledProcessesAreRemovedByTheNext) {
    const pid_t child = ::fork();
    if (child == 0) {
        // simulates a killed process, in which the destructor does not run
        new StagedFolder(folder / "log");
        new StagedFolder(folder / "third");
        ::_exit(0);
    }
    ::waitpid(child, nullptr, 0);
    EXPECT_EQ(files().size(), 2u);
    const std::string of_running = fmt::format(".log.tmp-{}", ::getppid()),
                      of_other_program = fmt::format(".other.tmp-{}", child),
                      of_other_machine = fmt::format(".far.tmp-{}", child);
    for (const std::string& name : {of_running, of_other_program, of_other_machine})
        fs::create_directory(folder / name);
    const int locked =
        ::open((folder / of_other_machine / ".relidar_staged").c_str(), O_RDWR | O_CREAT, 0600);
    ASSERT_EQ(::flock(locked, LOCK_EX), 0);
    { const StagedFolder staged(folder / "log"); }
    EXPECT_THAT(files(), testing::UnorderedElementsAre(of_running, of_other_program, of_other_machine));
    ::close(locked);
    { const StagedFolder staged(folder / "log"); }
    EXPECT_THAT(files(), testing::UnorderedElementsAre(of_running, of_other_program));
}

TEST_F(AtomicFile, NoticesAFullDiskInEveryWriter) {
    std::vector<float> noise(64 * 64);
    // values that cannot be compressed
    for (std::size_t i = 0; i < noise.size(); ++i) noise[i] = float(i * 2654435761u % 65537u) / 65537.0f;
    const NamedArray array = make_array("noise", {64, 64}, noise.data(), noise.size());
    const LidarPoints cloud{std::vector<glm::vec3>(4096), std::vector<float>(4096)};
    Report report;
    report.summary = std::string(20'000, 'x');
    const std::vector<std::function<void(const fs::path&)>> writers = {
        // fails in the last flush
        [&](const fs::path& path) { write_text_file(path, std::string(5000, 'x')); },
        // fails in the write
        [&](const fs::path& path) { write_text_file(path, std::string(5'000'000, 'x')); },
        [&](const fs::path& path) { write_npz(path, {array}); },
        [&](const fs::path& path) { write_safetensors(path, {array}, {}); },
        [&](const fs::path& path) { write_ply(path, cloud); },
        [&](const fs::path& path) { write_pcd(path, cloud); },
        [&](const fs::path& path) { write_kitti_bin(path, cloud); },
        [&](const fs::path& path) {
            write_exr(path, 64, 64, {{"noise", noise}});
        },
        [&](const fs::path& path) { write_png(path, apply_colour_map(noise, 64, 64, 0, 1, "turbo")); },
        [&](const fs::path& path) { write_report(path, report); },
    };
    for (std::size_t i = 0; i < writers.size(); ++i) {
        SCOPED_TRACE(i);
        const test::FileSizeLimit limit(4096);
        const std::string message = get_data_error_message([&] { writers[i](folder / "full.bin"); });
        EXPECT_THAT(message,
                    testing::AllOf(testing::HasSubstr("File too large"), testing::HasSubstr("full.bin")));
        EXPECT_TRUE(files().empty());
    }
}

}  // namespace
}  // namespace relidar
