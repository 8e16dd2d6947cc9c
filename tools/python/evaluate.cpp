// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/error.hpp>
#include <relidar/score/evaluation.hpp>
#include "calls.hpp"
#include "log.hpp"
#include "module.hpp"
#include "run.hpp"

namespace relidar::python {
namespace {

/// Scores the held-out frames of a run, or of a baseline. A baseline needs the training
/// scans but no device.
/// @param log  has the scans, which a run does not store
Evaluation evaluate_loaded(LoadedRun& loaded, const Log& log, const std::optional<std::string>& baseline,
                           const Progress& progress) {
    Run run = loaded.run;  // The scans are added only to this copy, and freed with it.
    copy_scans(run, run.split.test, log);
    if (baseline) {
        copy_scans(run, run.split.train, log);
        const py::gil_scoped_release gil_released;
        return evaluate_baseline(*baseline, run.config, run.log, run.split, progress);
    }
    return loaded.get_renderer().use([&](ScanRenderer& renderer) {
        // Shows the instances that an earlier render() has hidden.
        renderer.show_instances(std::vector<bool>(run.scene.instances.size(), true));
        return evaluate_frames(renderer, run.config, run.log, run.split.test, progress);
    });
}

/// Scores the held-out frames of a run, and returns the means and the values of each
/// frame.
/// @param log  null: read the log from the path in the settings of the run
py::dict evaluate_run(LoadedRun& loaded, const LoadedLog* log, const std::optional<std::string>& baseline,
                      const PythonProgressCallback& report_progress) {
    // Throws an error if the baseline is unknown. This is checked before the log is
    // loaded, because loading takes a long time.
    if (baseline) (void)parse_baseline(*baseline);
    const Run& run = loaded.run;
    if (run.split.test.empty())
        throw DataError(run.folder.string() + ": the run has no held-out frames, expected at least one");
    const Progress progress = wrap_progress(report_progress);
    Log own_log;
    if (!log) {
        const py::gil_scoped_release gil_released;
        limit_scan_memory(std::uint64_t(run.config.dataset.memory_mib) << 20);
        own_log = load_log(run.config, progress);
    }
    const Evaluation result = evaluate_loaded(loaded, log ? log->log : own_log, baseline, progress);
    py::list frames;
    for (const ScoredFrame& frame : result.frames)
        frames.append(py::dict(py::arg("frame") = frame.frame, py::arg("time_s") = frame.time_s,
                               py::arg("metrics") = frame.metrics));
    return py::dict(py::arg("mean") = result.mean, py::arg("frames") = frames,
                    py::arg("trace_ms") = result.trace_ms);
}

}  // namespace

/// Adds relidar.evaluate().
void bind_evaluate(py::module_& module) {
    module.def("evaluate", &evaluate_run, py::arg("run"), py::arg("log") = py::none(), py::kw_only(),
               py::arg("baseline") = py::none(), py::arg("progress") = py::none(),
               "Scores the held-out frames of a run against its log, like `relidar eval`.\n\n"
               "log: the log; None: read it from the path that was used for training\n"
               "baseline: \"nearest\" or \"nearest-actors\" scores the neighbouring real scans, moved to the "
               "held-out pose, instead of rendered scans\n"
               "progress: called with the name of a step and its progress from 0 to 1\n\n"
               "Returns mean (metric -> value; names carry protocol and unit, \"strict/depth_medae_m\"), "
               "frames (frame, time_s and metrics of each) and trace_ms, milliseconds per\n"
               "frame. Raises DataError if the log differs from that of the training.");
}

}  // namespace relidar::python
