// SPDX-License-Identifier: Apache-2.0
// A new folder is written under a temporary name and then renamed. In an existing folder,
// all files are first written to a temporary subfolder and then moved, config.toml last,
// because load_run() rejects a folder without this file.
#include <relidar/run/run.hpp>

#include <cerrno>
#include <system_error>
#include <vector>

#include <fcntl.h>
#include <unistd.h>

#include <relidar/base/files.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/run/stage_options.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "run/files/run_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr const char *kConfigFile = "config.toml", *kSceneFile = "scene.json",
                     *kDropNetworkFile = "drop_network.safetensors", *kSweepsFile = "sweeps.safetensors",
                     *kCoverageFile = "coverage.safetensors", *kClassesFile = "classes.safetensors",
                     *kScatterFile = "intensity_scatter.safetensors", *kBodiesFile = "own_body.safetensors";

void create_folder(const fs::path& folder) {
    std::error_code failed;
    fs::create_directories(folder, failed);
    std::error_code unknown;
    if (!fs::is_directory(folder, unknown))
        fail("cannot create the folder {}: {}", folder.string(),
             failed ? failed.message() : "a file with this name exists");
}

/// Creates a hard link to a file, because the files of blocks are large and never change.
/// Copies the file if the file system cannot create the link.
void link_file(const fs::path& source_file, const fs::path& target_file) {
    create_folder(target_file.parent_path());
    std::error_code failed;
    fs::remove(target_file, failed);
    fs::create_hard_link(source_file, target_file, failed);
    if (!failed) return;
    write_atomically(target_file, [&](const fs::path& temporary) {
        std::error_code why;
        if (!fs::copy_file(source_file, temporary, why))
            fail("cannot copy {}: {}", source_file.string(), why.message());
    });
}

/// Links or copies the block files to `target`. Returns the blocks with the new paths.
/// @param skip_linked  true: skips files that are already in the folder of the run
std::vector<SceneBlock> link_blocks(const Run& run, const fs::path& target, bool skip_linked) {
    std::vector<SceneBlock> blocks = run.scene.blocks;
    for (std::size_t i = 0; i < blocks.size(); ++i) {
        const fs::path file = fs::path("blocks") / fmt::format("{:03}", i) / kModelFile;
        std::error_code failed;
        const bool is_linked = fs::equivalent(blocks[i].file, run.folder / file, failed);
        if (!(skip_linked && is_linked)) link_file(blocks[i].file, target / file);
        blocks[i].file = target / file;
    }
    return blocks;
}

/// Writes the settings of a run to config.toml. Only presets can change some fields of
/// Config, so the file contains only the name of the preset for them. Throws an error if
/// a program has changed such a field, because the file would not describe the run.
/// @param folder  staging folder; an error message names the folder of the run instead
void save_run_config(const Run& run, const fs::path& folder) {
    const fs::path path = folder / kConfigFile;
    write_text_file(path, to_toml(run.config));
    const bool is_complete = load_settings(path) == run.config;
    if (!is_complete)
        fail(
            "cannot save {}: the file can store only the preset {} and settings, but the program changed a "
            "field of Config that is not a setting; change only the settings that `relidar list settings "
            "--all` prints",
            (run.folder / kConfigFile).string(), run.config.preset);
}

/// Writes the model of a run, and links the files of its background blocks.
void save_scene(const Run& run, const fs::path& folder, bool keep_block_files) {
    if (run.scene.blocks.empty()) return save_model(folder / kModelFile, run.scene);
    // The scene has only the actors. Background surfels are in block files.
    Scene scene = run.scene;
    scene.blocks = link_blocks(run, folder, keep_block_files);
    save_model(folder / kModelFile, scene);
}

/// Writes all files of a run to a folder.
/// @param keep_block_files  true: block files that the folder of the run already has are
/// not linked again, because they stay there
void write_run_files(const Run& run, const fs::path& folder, bool keep_block_files) {
    // The small text files first, so that an invalid value causes an error early.
    write_text_file(folder / kSceneFile, files::format_scene(run));
    save_run_config(run, folder);
    save_scene(run, folder, keep_block_files);
    if (!run.drop_network.empty()) save_drop_network(folder / kDropNetworkFile, run.drop_network);
    files::save_azimuths(folder / kSweepsFile, run.log);
    files::save_bodies(folder / kBodiesFile, run.log.lidars);
    files::save_coverage(folder / kCoverageFile, run.coverage);
    files::save_class_map(folder / kClassesFile, run.classes);
    files::save_scatter(folder / kScatterFile, run.intensity_scatter);
}

/// Writes all files of a run to a temporary folder. Error messages show the final file
/// names, not the temporary names.
void stage_run(const Run& run, const fs::path& staging_folder, bool keep_block_files) {
    try {
        write_run_files(run, staging_folder, keep_block_files);
    } catch (const DataError& error) {
        const std::string staging = staging_folder.string(), final_name = run.folder.string();
        std::string message = error.what();
        std::size_t at = message.find(staging);
        while (at != std::string::npos) {
            message.replace(at, staging.size(), final_name);
            at = message.find(staging, at + final_name.size());
        }
        throw DataError(message);
    }
}

/// A folder next to the files of a run, on the same file system, so that files can be
/// renamed from it. The destructor removes it.
struct TemporaryFolder {
    fs::path path;

    explicit TemporaryFolder(const fs::path& parent) : path(make_temp_path(parent / "run")) {
        create_folder(path);
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
        fail("cannot write '{}': renaming the temporary file failed: {}", target.string(), failed.message());
}

/// Moves the files of `staging` to the run's folder. scene.json and a changed config.toml
/// are removed first and moved last, so that an interrupted move leaves no run that looks
/// complete. An equal config.toml stays, so that training can be resumed even then.
/// @param remove_old  removes other files of an earlier run; may be empty
void move_files(const fs::path& staging, const fs::path& folder, const std::function<void()>& remove_old) {
    const bool is_same_config = does_path_exist(folder / kConfigFile) &&
                                read_file(folder / kConfigFile) == read_file(staging / kConfigFile);
    // remove_old() belongs to a new training, which does not resume the old one.
    const bool keeps_config = is_same_config && !remove_old;
    // From here on, the folder does not look complete.
    if (!keeps_config) fs::remove(folder / kConfigFile);
    fs::remove(folder / kSceneFile);
    if (remove_old) remove_old();
    // Optional files of an earlier save that the new run does not have.
    for (const char* name :
         {kDropNetworkFile, kSweepsFile, kBodiesFile, kCoverageFile, kClassesFile, kScatterFile})
        if (!does_path_exist(staging / name)) fs::remove(folder / name);
    std::vector<fs::path> files;  // listed before the moves change the folder
    for (const auto& entry : fs::recursive_directory_iterator(staging))
        if (entry.is_regular_file()) files.push_back(entry.path().lexically_relative(staging));
    std::erase(files, kSceneFile);
    std::erase(files, kConfigFile);
    for (const fs::path& file : files) {
        create_folder((folder / file).parent_path());
        rename_file(staging / file, folder / file);
    }
    rename_file(staging / kSceneFile, folder / kSceneFile);
    if (!keeps_config) rename_file(staging / kConfigFile, folder / kConfigFile);
}

}  // namespace

void save_run(const Run& run) { overwrite_run(run, {}); }

void replace_run(const Run& run) {
    const StagedFolder staged(run.folder);
    stage_run(run, staged.path(), false);
    staged.replace_folder();
}

void overwrite_run(const Run& run, const std::function<void()>& remove_earlier_files) {
    if (!does_path_exist(run.folder)) {
        const StagedFolder staged(run.folder);
        stage_run(run, staged.path(), false);
        return staged.publish_folder();
    }
    create_folder(run.folder);  // throws an error with the reason if the path is a file and not a folder
    // The new files are complete before old files are removed.
    const TemporaryFolder staged(run.folder);
    // remove_earlier_files() may also remove the block files of the folder.
    const bool keep_block_files = !remove_earlier_files;
    stage_run(run, staged.path, keep_block_files);
    move_files(staged.path, run.folder, remove_earlier_files);
}

namespace {

/// Removes the classes of objects that stood in the background and were released or
/// removed (release_standing()). The ground below them keeps its class.
void erase_released(SurfaceClassMap& classes, const Log& log_before, const SceneWithLog& edited) {
    constexpr SurfaceClass kGround[] = {SurfaceClass::road, SurfaceClass::sidewalk, SurfaceClass::terrain,
                                        SurfaceClass::other_ground};
    if (classes.empty()) return;
    for (const BoxTrack& box : log_before.boxes) {
        const std::optional<BoxTrack> object = find_standing({Scene{}, log_before}, box.id);
        const bool is_background = find_standing({edited.scene, edited.log}, box.id).has_value();
        if (!object || is_background) continue;
        const Pose box_from_world = inverse(object->world_from_box.pose.front());
        const glm::dvec3 reach_m = 0.5 * box.size_m + kMoverMargin_m;
        std::erase_if(classes, [&](const SurfaceClassCell& cell) {
            const glm::dvec3 centre_m = kClassCell_m * (glm::dvec3(cell.grid_index) + 0.5);
            return glm::all(glm::lessThan(glm::abs(box_from_world * centre_m), reach_m)) &&
                   std::ranges::count(kGround, cell.surface) == 0;
        });
    }
}

}  // namespace

void Run::set_driving_scene(SceneWithLog driving_scene) {
    erase_released(classes, log, driving_scene);
    driving_scene = complete_actors(std::move(driving_scene), log.boxes);
    scene = std::move(driving_scene.scene);
    log = std::move(driving_scene.log);
}

namespace {

/// Loads the files that only some runs have.
void load_optional_files(Run& run) {
    const auto is_present = [&](const char* name) { return does_path_exist(run.folder / name); };
    if (is_present(kSweepsFile)) files::load_azimuths(run.folder / kSweepsFile, run.log);
    if (is_present(kBodiesFile)) files::load_bodies(run.folder / kBodiesFile, run.log.lidars);
    if (is_present(kCoverageFile)) run.coverage = files::load_coverage(run.folder / kCoverageFile);
    if (is_present(kClassesFile)) run.classes = files::load_class_map(run.folder / kClassesFile);
    if (is_present(kScatterFile))
        run.intensity_scatter = files::load_scatter(run.folder / kScatterFile, run.log.lidars.size());
    if (is_present(kDropNetworkFile)) run.drop_network = load_drop_network(run.folder / kDropNetworkFile);
}

/// Checks that the files of a run belong together.
/// @param n_surfels  number of surfels according to scene.json
void check_run_files(const Run& run, std::size_t n_surfels) {
    const Surfels& surfels = run.scene.surfels;
    if (surfels.size() != n_surfels)
        fail("{}: counts.surfels is {}, but {} contains {} surfels", (run.folder / kSceneFile).string(),
             n_surfels, kModelFile, surfels.size());
    if (surfels.size() > 0 && surfels.primitive != run.config.image.primitive)
        fail("{}: image.primitive is {}, but {} contains {}; change this setting to {}",
             (run.folder / kConfigFile).string(), properties_of(run.config.image.primitive).name, kModelFile,
             properties_of(surfels.primitive).label, properties_of(surfels.primitive).name);
}

}  // namespace

Run load_run(const fs::path& folder) {
    require_folder(folder, "a run folder");
    for (const char* name : {kConfigFile, kSceneFile, kModelFile})
        if (!does_path_exist(folder / name))
            fail("the file {} is missing, but every run folder must contain it", (folder / name).string());
    Run run;
    run.folder = folder;
    const fs::path scene_path = folder / kSceneFile;
    const Config settings = load_settings(folder / kConfigFile);
    files::SceneJsonContents contents = files::parse_scene(read_text_file(scene_path), scene_path.string());
    run.log = std::move(contents.log);
    run.config = with_max_range(settings, run.log);
    run.split = std::move(contents.split);
    run.edits = std::move(contents.edits);
    run.held_out_placed = contents.held_out_placed;
    run.refined_poses = std::move(contents.refined_poses);
    run.scene = load_model(folder / kModelFile);
    for (const SceneBlock& block : run.scene.blocks)
        if (!does_path_exist(block.file))
            fail("the file {} is missing, but this run has {} blocks with one file each", block.file.string(),
                 run.scene.blocks.size());
    load_optional_files(run);
    check_run_files(run, contents.n_surfels);
    return run;
}

bool is_run_folder(const fs::path& path) {
    std::error_code failed;
    return fs::is_regular_file(path / kSceneFile, failed) || fs::is_regular_file(path / kModelFile, failed);
}

void prepare_folder(const fs::path& folder) {
    create_folder(folder);
    // The name of the test file contains the process id, because several processes may
    // test the same folder. If the process is killed here, remove_temp() deletes the file
    // later.
    const std::string probe = (folder / fmt::format(".probe.tmp-{}-0", ::getpid())).string();
    const int file = ::open(probe.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    if (file < 0) fail("cannot write to '{}': {}", folder.string(), std::generic_category().message(errno));
    ::close(file);
    ::unlink(probe.c_str());
}

}  // namespace relidar
