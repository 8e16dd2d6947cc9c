// SPDX-License-Identifier: Apache-2.0
// Reads and writes run folders. A new folder is written under a temporary name and then
// renamed. For an existing folder, all files are first written to a temporary subfolder
// and then moved to the folder. config.toml is moved last, because load_run() rejects a
// folder without this file. Every error message of load_run() names the file.
#include <relidar/run/run.hpp>

#include <cerrno>
#include <cstdlib>
#include <system_error>
#include <vector>

#include <fcntl.h>
#include <unistd.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/files.hpp>
#include <relidar/run/stage_options.hpp>
#include "base/files.hpp"
#include "run/files/coverage_file.hpp"
#include "run/files/scatter_file.hpp"
#include "run/files/scene_json.hpp"
#include "run/files/sweeps_file.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr const char* kConfigFile = "config.toml";
constexpr const char* kSceneFile = "scene.json";
constexpr const char* kDropNetworkFile = "drop_network.safetensors";
constexpr const char* kSweepsFile = "sweeps.safetensors";
constexpr const char* kCoverageFile = "coverage.safetensors";
constexpr const char* kClassesFile = "classes.safetensors";
constexpr const char* kScatterFile = "intensity_scatter.safetensors";

void make_folder(const fs::path& folder) {
    std::error_code failed;
    fs::create_directories(folder, failed);
    std::error_code unknown;
    if (!fs::is_directory(folder, unknown))
        throw DataError(fmt::format("cannot create the folder {}: {}", folder.string(),
                                    failed ? failed.message() : "a file with this name exists"));
}

/// Creates a hard link to a file. If the file system cannot create the link, copies the
/// file.
void link_or_copy(const fs::path& source, const fs::path& target) {
    make_folder(target.parent_path());
    std::error_code failed;
    fs::remove(target, failed);
    fs::create_hard_link(source, target, failed);
    if (!failed) return;
    write_atomically(target, [&](const fs::path& temporary) {
        std::error_code why;
        if (!fs::copy_file(source, temporary, why))
            throw DataError(fmt::format("cannot copy {}: {}", source.string(), why.message()));
    });
}

/// Links or copies the files of the background blocks to `folder`. Returns the blocks
/// with the new file paths.
/// @param keep  true to skip files that are already in the folder of the run
std::vector<SceneBlock> copy_blocks(const Run& run, const fs::path& folder, bool keep) {
    std::vector<SceneBlock> blocks = run.scene.blocks;
    for (std::size_t i = 0; i < blocks.size(); ++i) {
        const fs::path file = fs::path("blocks") / fmt::format("{:03}", i) / kModelFile;
        std::error_code failed;
        if (!keep || !fs::equivalent(blocks[i].file, run.folder / file, failed))
            link_or_copy(blocks[i].file, folder / file);
        blocks[i].file = folder / file;
    }
    return blocks;
}

/// Writes the settings of a run to config.toml. Some options are not settings, so the
/// file cannot store them. Throws an error if such an option differs from the preset.
void save_config(const Run& run, const fs::path& folder) {
    const fs::path path = folder / kConfigFile;
    write_text(path, to_toml(run.config));
    if (load_saved_config(path) != run.config)
        throw DataError(fmt::format(
            "cannot save {}: an option that is not a setting differs from preset {}; change only the "
            "settings that `relidar list settings --all` prints",
            (run.folder / kConfigFile).string(), run.config.preset));
}

void save_scene(const Run& run, const fs::path& folder, bool keep_blocks) {
    if (run.scene.blocks.empty()) return save_model(folder / kModelFile, run.scene);
    // This scene contains only the actors, because the background is stored in blocks.
    Scene scene = run.scene;
    scene.blocks = copy_blocks(run, folder, keep_blocks);
    save_model(folder / kModelFile, scene);
}

void write_files(const Run& run, const fs::path& folder, bool keep_blocks) {
    // Writes the small text files first, so that an invalid value causes an error early.
    write_text(folder / kSceneFile, run_detail::to_scene_json(run));
    save_config(run, folder);
    save_scene(run, folder, keep_blocks);
    if (!run.drop_network.empty()) save_drop_network(folder / kDropNetworkFile, run.drop_network);
    run_detail::save_sweeps(folder / kSweepsFile, run.sequence);
    run_detail::save_coverage(folder / kCoverageFile, run.coverage);
    run_detail::save_classes(folder / kClassesFile, run.classes);
    run_detail::save_scatter(folder / kScatterFile, run.intensity_scatter);
}

/// Writes all files of a run to a temporary folder. Error messages name the final files
/// in the run's folder instead of the temporary files.
void write_staged_files(const Run& run, const fs::path& staged, bool keep_blocks) {
    try {
        write_files(run, staged, keep_blocks);
    } catch (const DataError& error) {
        std::string message = error.what();
        for (std::size_t at = 0; (at = message.find(staged.string(), at)) != std::string::npos;
             at += run.folder.string().size())
            message.replace(at, staged.string().size(), run.folder.string());
        throw DataError(message);
    }
}

/// A temporary folder. The destructor deletes the folder and its contents.
struct TemporaryFolder {
    fs::path path;

    explicit TemporaryFolder(const fs::path& parent) : path(make_temporary_path(parent / "run")) {
        make_folder(path);
    }
    ~TemporaryFolder() {
        std::error_code failed;
        fs::remove_all(path, failed);
    }
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;
};

void rename_file(const fs::path& source, const fs::path& target) {
    std::error_code failed;
    fs::rename(source, target, failed);
    if (failed)
        throw DataError(fmt::format("cannot write '{}': renaming the temporary file failed: {}",
                                    target.string(), failed.message()));
}

/// Returns true if a file exists and its contents equal `bytes`.
bool holds(const fs::path& file, const std::string& bytes) {
    return does_path_exist(file) && read_file(file) == bytes;
}

/// Moves the files of `staged` to the run's folder. An unchanged config.toml stays in
/// place, so that training can be resumed even if the process is killed during the move.
void move_files(const fs::path& staged, const fs::path& folder, const std::function<void()>& remove_earlier) {
    const bool same_config = holds(folder / kConfigFile, read_file(staged / kConfigFile));
    if (!same_config || remove_earlier) fs::remove(folder / kConfigFile);
    fs::remove(folder / kSceneFile);
    if (remove_earlier) remove_earlier();
    for (const char* name : {kDropNetworkFile, kSweepsFile, kCoverageFile, kClassesFile, kScatterFile})
        if (!does_path_exist(staged / name)) fs::remove(folder / name);
    std::vector<fs::path> files;
    for (const auto& entry : fs::recursive_directory_iterator(staged))
        if (entry.is_regular_file()) files.push_back(entry.path().lexically_relative(staged));
    std::erase(files, kSceneFile), std::erase(files, kConfigFile);
    for (const fs::path& file : files) {
        make_folder((folder / file).parent_path());
        rename_file(staged / file, folder / file);
    }
    rename_file(staged / kSceneFile, folder / kSceneFile);
    if (!same_config || remove_earlier) rename_file(staged / kConfigFile, folder / kConfigFile);
}

}  // namespace

void save_run(const Run& run) { replace_run(run, {}); }

void replace_folder(const Run& run) {
    const StagedFolder staged(run.folder);
    write_staged_files(run, staged.path(), false);
    staged.finish();
}

void replace_run(const Run& run, const std::function<void()>& remove_earlier) {
    if (!does_path_exist(run.folder)) {
        const StagedFolder staged(run.folder);
        write_staged_files(run, staged.path(), false);
        return staged.finish_without_replacing();
    }
    make_folder(run.folder);  // throws an error with the reason if the path is a file and not a folder
    const TemporaryFolder staged(run.folder);
    write_staged_files(run, staged.path, !remove_earlier);
    move_files(staged.path, run.folder, remove_earlier);
}

Run load_run(const fs::path& folder) {
    check_folder(folder, "a run folder");
    for (const char* name : {kConfigFile, kSceneFile, kModelFile}) {
        if (!does_path_exist(folder / name))
            throw DataError(
                fmt::format("{} is missing, but every run folder must contain it", (folder / name).string()));
    }
    Run run;
    run.folder = folder;
    run.config = load_saved_config(folder / kConfigFile);
    const fs::path scene_path = folder / kSceneFile;
    run_detail::SceneFile scene = run_detail::parse_scene_json(read_text(scene_path), scene_path.string());
    run.sequence = std::move(scene.sequence);
    run.config = use_farthest_return(std::move(run.config), run.sequence);
    run.split = std::move(scene.split);
    run.edits = std::move(scene.edits);
    run.held_out_placed = scene.held_out_placed;
    run.refined_poses = std::move(scene.refined_poses);
    run.scene = load_model(folder / kModelFile);
    for (const SceneBlock& block : run.scene.blocks)
        if (!does_path_exist(block.file))
            throw DataError(fmt::format("{} is missing, but this run has {} blocks with one file each",
                                        block.file.string(), run.scene.blocks.size()));
    if (does_path_exist(folder / kSweepsFile)) run_detail::load_sweeps(folder / kSweepsFile, run.sequence);
    if (does_path_exist(folder / kCoverageFile))
        run.coverage = run_detail::load_coverage(folder / kCoverageFile);
    if (does_path_exist(folder / kClassesFile)) run.classes = run_detail::load_classes(folder / kClassesFile);
    if (does_path_exist(folder / kScatterFile))
        run.intensity_scatter = run_detail::load_scatter(folder / kScatterFile, run.sequence.lidars.size());
    if (does_path_exist(folder / kDropNetworkFile))
        run.drop_network = load_drop_network(folder / kDropNetworkFile);
    if (run.scene.surfels.size() != scene.n_surfels) {
        throw DataError(fmt::format("{}: counts.surfels is {}, but {} contains {} surfels",
                                    scene_path.string(), scene.n_surfels, kModelFile,
                                    run.scene.surfels.size()));
    }
    if (run.scene.surfels.size() > 0 && run.scene.surfels.primitive != run.config.image.primitive)
        throw DataError(fmt::format("{}: image.primitive is {}, but {} contains {}",
                                    (folder / kConfigFile).string(),
                                    get_primitive_kind(run.config.image.primitive).name, kModelFile,
                                    get_primitive_kind(run.scene.surfels.primitive).label));
    return run;
}

bool is_run(const fs::path& path) {
    std::error_code failed;
    return fs::is_regular_file(path / kSceneFile, failed) || fs::is_regular_file(path / kModelFile, failed);
}

void check_writable(const fs::path& folder) {
    make_folder(folder);
    // Several processes may test the same folder, so the name of the test file contains
    // the process id. If the process is killed here, remove_temporaries() deletes the
    // file later.
    const std::string probe = (folder / fmt::format(".probe.tmp-{}-0", ::getpid())).string();
    const int file = ::open(probe.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    if (file < 0)
        throw DataError(
            fmt::format("cannot write to '{}': {}", folder.string(), std::generic_category().message(errno)));
    ::close(file);
    ::unlink(probe.c_str());
}

}  // namespace relidar
