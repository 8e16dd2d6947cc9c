// SPDX-License-Identifier: Apache-2.0
// relidar render: scans of a run, from where the sensor was or beside it, by its own sensor or another, as files.
#include <algorithm>
#include <chrono>
#include <memory>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "scan_files.hpp"
#include <relidar/render.hpp>
#include <relidar/run.hpp>

namespace relidar::cli {
namespace {

struct Options {
    std::string run;
    std::string out;
    std::string frames = "test";
    std::string offset;
    std::string sensor;
    std::string formats = "npz";
    std::vector<std::string> sets;
    std::vector<std::string> only;
    DeviceChoice device;
    bool quiet = false;
};

/// Positions of the wanted frames. @throws UsageError where there is none
std::vector<int> choose_frames(const Run& run, const std::string& which) {
    std::vector<int> positions;
    if (which == "test" || which == "train") {
        positions = which == "test" ? run.split.test : run.split.train;
    } else {
        const FrameRange range = which == "all" ? FrameRange{} : parse_frames(which);
        for (int i = 0; i < static_cast<int>(run.sequence.frames.size()); ++i) {
            const int index = run.sequence.frames[static_cast<std::size_t>(i)].index;
            if (index >= range.begin && (range.end < 0 || index < range.end)) positions.push_back(i);
        }
    }
    if (positions.empty()) {
        throw UsageError(fmt::format("--frames {}: no frame of {} lies in it, expected numbers in {}..{}, or test, train or all", which, run.folder.string(),
                                     run.sequence.frames.front().index, run.sequence.frames.back().index));
    }
    return positions;
}

/// "x,y,z,yaw_deg" in the sensor's frame.
Pose parse_offset(const std::string& text) {
    if (text.empty()) return {};
    const std::vector<double> v = parse_list("--offset", text);
    if (v.size() != 3 && v.size() != 4) throw UsageError(fmt::format("--offset: found {} numbers in \"{}\", expected x,y,z or x,y,z,yaw_deg", v.size(), text));
    const double yaw_rad = v.size() == 4 ? v[3] * kPi / 180.0 : 0.0;
    return {glm::angleAxis(yaw_rad, glm::dvec3(0.0, 0.0, 1.0)), {v[0], v[1], v[2]}};
}

void run_render(const Options& options) {
    const std::vector<std::string> formats = parse_formats(options.formats);
    const Pose offset = parse_offset(options.offset);
    const OutputFolder folder(options.out);
    Run run = load_run(options.run);
    apply_sets(run.config, options.sets);
    const std::vector<int> positions = choose_frames(run, options.frames);
    const SensorChoice sensor = options.sensor.empty() ? configured_sensor(run.config, run.sequence) : choose_sensor(options.sensor, run.config, run.sequence);
    const std::vector<bool> shown = select_instances(run.scene, options.only);
    const std::vector<std::string> names = instance_names(run.scene);
    Device device(device_options(options.device));
    ScanRenderer renderer(device, run.scene, run.config, run.sequence);
    if (!options.only.empty()) renderer.show_only(shown);

    catch_interrupts();
    Progress progress(options.quiet);
    double trace_ms = 0.0;
    for (std::size_t done = 0; done < positions.size(); ++done) {
        stop_if_interrupted();
        const Frame& frame = run.sequence.frames[static_cast<std::size_t>(positions[done])];
        const RenderedScan scan = renderer.render(sensor, frame.time_s, offset);
        write_scan(folder.path(), frame.index, scan, {formats, names});
        trace_ms += scan.trace_ms;
        progress.count(fmt::format("rendering frame {}:", frame.index), done + 1, positions.size());
    }
    end_progress_line();
    if (options.quiet) return;
    const double mrays = static_cast<double>(sensor.rays.size() * positions.size()) / 1e6;
    print(fmt::format("{} scans of {} rays in {} ({}); tracing {:.1f} ms a scan, {:.3f} Mrays/s\n", positions.size(), sensor.rays.size(), options.out, fmt::join(formats, ", "),
                      trace_ms / static_cast<double>(positions.size()), trace_ms > 0.0 ? 1000.0 * mrays / trace_ms : 0.0));
}

}  // namespace

void add_render(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("render", "render scans of a trained run");
    const auto options = std::make_shared<Options>();
    command->add_option("RUN", options->run, "run folder of `relidar train`")->required();
    command->add_option("--out", options->out, "folder for the scans")->required()->type_name("DIR");
    command->add_option("--frames", options->frames, "first:end by the dataset's numbers, or test, train or all (default: test)")->type_name("WHICH");
    command->add_option("--offset", options->offset, "move the sensor, in its own frame: forward, left, up in metres, turn left in degrees")->type_name("X,Y,Z,YAW_DEG");
    command->add_option("--sensor", options->sensor, "another sensor: native, kitti360, VLP-16, HDL-64E, OS1-64, OS1-128, waymo-top, or a CSV beam table as in beams.csv:1024x10")->type_name("NAME|FILE");
    command->add_option("--format", options->formats, "npz, exr, ply, pcd, bin, png, parted by commas (default: npz)")->type_name("LIST");
    command->add_option("--only", options->only, "render this alone: background, actors, or a track; repeatable")->type_name("WHAT")->type_size(1)->allow_extra_args(false);
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer("Files are DIR/frame_000123.npz and so on, by the dataset's frame number.\n"
                    "npz: range, median_range, intensity, drop_prob, weight [rows,columns]; directions, origin [rows,columns,3] in the sensor frame;\n"
                    "pose [4,4] sensor to the dataset's world; time_s. Metres. ply, pcd, bin: points of rays with drop_prob < 0.5, sensor frame.\n"
                    "instance (npz, ply, pcd): whose surface a ray meets first, the number in `relidar info RUN`, 0 background, -1 nothing; npz has instance_names.\n"
                    "Examples:\n"
                    "  relidar render run --out scans\n"
                    "  relidar render run --out cars --only actors --format ply\n"
                    "  relidar render run --out left --frames 10:20 --offset 0,2,1,0 --format npz,ply\n"
                    "  relidar render run --out small --sensor VLP-16 --format png");
    command->callback([&call, options] { call.run = [options] { run_render(*options); }; });
}

}  // namespace relidar::cli
