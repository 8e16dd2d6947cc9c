// SPDX-License-Identifier: Apache-2.0

#include <pybind11/stl/filesystem.h>

#include <relidar/base/error.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>
#include "calls.hpp"
#include "log.hpp"
#include "losses.hpp"
#include "module.hpp"
#include "run.hpp"

namespace relidar::python {
namespace {

namespace fs = std::filesystem;

struct TrainArguments {
    std::optional<Config> config;
    std::optional<std::function<py::object(const TrainProgress&)>> callback;
    std::optional<std::function<void(const std::string&)>> note;
    std::optional<fs::path> checkpoints;
    bool resume;
    std::vector<py::function> losses;
    SharedDevice device;
};

/// Returns the settings of a training: those of the user, except settings with which the
/// log was already read. The log is split into training and held-out frames only now.
Config merge_settings(const LoadedLog& loaded, const std::optional<Config>& requested) {
    if (!requested) return loaded.config;
    Config config = *requested;
    config.dataset = loaded.config.dataset;
    config.dataset.test_every = requested->dataset.test_every;
    config.dataset.test_frames = requested->dataset.test_frames;
    config.sensor.rolling_shutter = loaded.config.sensor.rolling_shutter;
    return config;
}

std::optional<Checkpoint> load_checkpoint(const TrainArguments& arguments,
                                          const std::function<void(const std::string&)>& print_note) {
    if (!arguments.resume) return std::nullopt;
    if (!arguments.checkpoints)
        throw UsageError(
            "train: resume=True needs the argument checkpoints, which is the folder that contains the "
            "checkpoints");
    return load_newest(*arguments.checkpoints, print_note);
}

/// Returns a function that passes lines of text to the Python function `note`, if the
/// user has given one.
std::function<void(const std::string&)> wrap_note(const TrainArguments& arguments,
                                                  PythonCallGuard& python_calls) {
    return [&](const std::string& line) {
        if (arguments.note) python_calls([&] { (*arguments.note)(line); });
    };
}

/// Returns a function that passes the progress to the Python function `callback`. It
/// returns false, which stops the training, after an exception in any Python function
/// or if the callback returned False.
std::function<bool(const TrainProgress&)> wrap_callback(const TrainArguments& arguments,
                                                        PythonCallGuard& python_calls) {
    return [&](const TrainProgress& line) {
        bool has_returned_false = false;
        const bool has_succeeded = python_calls([&] {
            if (arguments.callback) has_returned_false = (*arguments.callback)(line).is(py::bool_(false));
        });
        return has_succeeded && !has_returned_false;
    };
}

/// Trains the scene of a run. Python functions can add losses, receive progress, and
/// stop the training. `python_calls` keeps their first exception, and the training stops.
TrainResult train_scene(const SharedDevice& device, Run& run, const TrainArguments& arguments,
                        PythonCallGuard& python_calls) {
    std::vector<std::unique_ptr<PythonLoss>> owned_losses;
    std::vector<Loss*> losses;
    for (const py::function& function : arguments.losses) {
        owned_losses.push_back(std::make_unique<PythonLoss>(device, python_calls, function));
        losses.push_back(owned_losses.back().get());
    }
    const auto note = wrap_note(arguments, python_calls);
    const auto stop = [&] { return !python_calls.can_continue(); };
    const std::optional<Checkpoint> start = load_checkpoint(arguments, note);
    // Releases Python's global lock. From here on, only `python_calls` calls Python.
    const DeviceLock use(*device);
    // The progress of this step only checks for Ctrl-C and earlier exceptions.
    const auto check_signals = [&](std::string_view, double) { (void)python_calls.can_continue(); };
    prepare_log(run.log, run.split, run.config, {note, stop, check_signals});
    if (start) check_resume(*start, run.log, run.split, run.config);
    return train(device->device, run.log, run.split, run.config, wrap_callback(arguments, python_calls),
                 {.checkpoints = arguments.checkpoints.value_or(""),
                  .start = start ? &*start : nullptr,
                  .stop = stop,
                  .note = note,
                  .losses = std::move(losses)});
}

/// Registers the held-out scans and learns the scatter of the intensities.
void finish_run(LockableDevice& device, Run& run, PythonCallGuard& python_calls) {
    const ScanCallbacks callbacks{{}, [&] { return !python_calls.can_continue(); }};
    const DeviceLock use(device);
    register_held_out(device.device, run, callbacks);
    python_calls.rethrow();
    run.intensity_scatter = learn_scatter(device.device, run, callbacks);
    python_calls.rethrow();
}

/// Trains the ray-drop network. The run is also useful without it, so unsuitable training
/// data and a checkpoint of another network only cause a note.
void train_drop_network(LockableDevice& device, Run& run, const TrainArguments& arguments,
                        PythonCallGuard& python_calls) {
    const auto note = wrap_note(arguments, python_calls);
    const fs::path folder = arguments.checkpoints ? *arguments.checkpoints / kRefineCheckpoints : fs::path();
    std::optional<Checkpoint> start;
    try {
        if (arguments.resume) start = load_newest(folder, note);
        if (start) check_drop_resume(*start, run);
    } catch (const Error& error) {
        note(error.what());
        start.reset();  // trains from the beginning
    }
    try {
        const DeviceLock use(device);
        run.drop_network = train_drops(device.device, run,
                                       {.stop = [&] { return !python_calls.can_continue(); },
                                        .checkpoints = folder,
                                        .start = start ? &*start : nullptr,
                                        .note = note});
    } catch (const DataError& error) {
        note(error.what());
    }
    python_calls.rethrow();
    if (!folder.empty()) remove_checkpoints(folder);
}

/// Trains a run in the same steps as `relidar train`, but keeps it only in memory and
/// frees its scans at the end.
std::unique_ptr<LoadedRun> train_run(const LoadedLog& loaded, const TrainArguments& arguments) {
    const Config config = merge_settings(loaded, arguments.config);
    Run run;
    run.config = config;
    run.log = loaded.log;
    run.split = split_frames(loaded.log, config.dataset.test_every, config.dataset.test_frames);
    const SharedDevice device = device_or_default(arguments.device);
    PythonCallGuard python;
    TrainResult result;
    try {
        result = train_scene(device, run, arguments, python);
    } catch (const Error&) {
        // If a Python callback has raised an exception, raises this exception instead of
        // the error of the library.
        python.rethrow();
        throw;
    }
    python.rethrow();
    move_result(run, result);
    if (!result.interrupted) {
        finish_run(*device, run, python);
        if (config.refine.enabled) train_drop_network(*device, run, arguments, python);
    }
    for (Frame& frame : run.log.frames) frame.scan = {};
    return std::make_unique<LoadedRun>(std::move(run), device);
}

py::dict loss_dict(const TrainProgress& progress) {
    py::dict terms;
    for (std::size_t k = 0; k < progress.terms.size(); ++k) terms[kLossTermNames[k]] = progress.terms[k];
    return terms;
}

}  // namespace

void bind_train(py::module_& module) {
    py::class_<TrainProgress>(module, "TrainProgress", "One line of the training log.")
        .def_readonly("iteration", &TrainProgress::iteration)
        .def_readonly("n_iterations", &TrainProgress::n_iterations)
        .def_readonly("seconds", &TrainProgress::seconds, "Seconds since the training started.")
        .def_readonly("iterations_per_second", &TrainProgress::iterations_per_second)
        .def_readonly("eta_s", &TrainProgress::eta_s)
        .def_readonly("loss", &TrainProgress::loss, "Mean loss over the iterations since the previous line.")
        .def_property_readonly("terms", &loss_dict, "Dict of name -> weighted term of the loss.")
        .def_readonly("n_surfels", &TrainProgress::n_surfels);
    module.def(
        "train",
        [](const LoadedLog& loaded, std::optional<Config> config,
           std::optional<std::function<py::object(const TrainProgress&)>> callback,
           std::optional<std::function<void(const std::string&)>> note, std::optional<fs::path> checkpoints,
           bool resume, std::vector<py::function> losses, SharedDevice device) {
            return train_run(loaded, {std::move(config), std::move(callback), std::move(note),
                                      std::move(checkpoints), resume, std::move(losses), std::move(device)});
        },
        py::arg("log"), py::arg("config") = py::none(), py::kw_only(), py::arg("callback") = py::none(),
        py::arg("note") = py::none(), py::arg("checkpoints") = py::none(), py::arg("resume") = false,
        py::arg("losses") = py::tuple(), py::arg("device") = py::none(),
        "Trains a scene on the training frames of a log. With refine.enabled, it also trains the network "
        "that corrects ray-drop.\n\n"
        "config: settings; of dataset.*, only test_every and test_frames have an effect, because the log is "
        "already read. None: the settings that the log was read with\n"
        "callback: called with a TrainProgress every train.log_every iterations; if it returns False, the "
        "training ends with the current scene. It must not use the same device\n"
        "note: called with one line of text for each result that is estimated from the log, such as poses, "
        "and for each problem that does not end the training\n"
        "checkpoints: folder for checkpoints of the scene; a checkpoint is also written if the training "
        "stops early, for example by Ctrl-C. The subfolder drop_network has the checkpoints of the network\n"
        "resume: continue from the newest checkpoint in this folder, if there is one; pass equal losses\n"
        "losses: functions that get each batch of rays as an object. Each returns a torch tensor with one "
        "number that depends on batch.rendered, or adds to batch.gradients and returns a float. The result "
        "is added to the losses of the settings, as the term \"custom\". Attributes of batch:\n"
        "- rendered: dict of depth (metres, not divided by weight), weight, intensity, hit_logit, "
        "drop_logit, likelihood (0 if loss.likelihood is 0): [n]\n"
        "- measured: dict of range (metres, 0: no return), intensity, weight (0: unknown): [n]\n"
        "- rays: dict of origins [n,3], directions [n,3], times [n] (seconds, 3e38: unknown), world frame\n"
        "- gradients: dict like rendered, of all losses so far\n"
        "- shape: (rows, columns) if the rays form an image, otherwise None\n"
        "- n_returned, n_known: expected number of known rays with a return, and of known rays\n"
        "The arrays are torch tensors, or numpy arrays if torch is not installed. They are views of the "
        "memory of the device, valid until the loss returns\n\n"
        "Returns a Run that exists only in memory; call save() to store it. Raises KeyboardInterrupt on "
        "Ctrl-C, the exceptions of the callback and the losses, and DataError if the log cannot be used for "
        "training.");
}

}  // namespace relidar::python
