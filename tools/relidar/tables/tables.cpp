// SPDX-License-Identifier: Apache-2.0
// relidar tables: the tables of the LiDAR-RT paper, each part of its datasets trained, rendered and scored by the machinery of
// `relidar batch`, beside what the paper prints. docs/paper.md says what a row is, and what it is not.
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/evaluation.hpp>
#include <relidar/export.hpp>
#include "batch/plan.hpp"
#include "batch/summary.hpp"
#include "batch/work.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "output_folder.hpp"
#include "tables/plan.hpp"
#include "tables/text.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

/// Weights that do not fit are found before the first part is trained.
void check_lpips(const TablesOptions& options) {
    Config config;
    config.eval.lpips_weights = options.lpips;
    check_lpips_weights(config);
}

/// Does what can be done. @return how the jobs have ended; of no job where every part is missing
std::vector<JobReport> work_parts(BatchPlan& plan, const std::vector<TableEntry>& entries, const TablesOptions& options) {
    const std::string manifest = manifest_text(entries);
    if (manifest.find("name") == std::string::npos) return {};
    write_text(plan.manifest, manifest);
    plan = plan_batch(load_manifest(plan.manifest), plan.out, options.device);
    work(plan, {{}, options.retry_failed, options.quiet});
    write_summary(plan);
    return report_jobs(plan);
}

void write_tables(const fs::path& out, const std::vector<TableResult>& results, const TablesOptions& options,
                  const std::string& command_line) {
    for (const auto& [kind, file] : {std::pair("waymo", "table1_waymo.csv"), std::pair("kitti360", "table2_kitti360.csv")})
        write_text(out / file, table_csv(results, kind, false));
    if (options.ablation) write_text(out / "ablation.csv", table_csv(results, "kitti360", true));
    write_text(out / "tables.md", tables_markdown(results, options, command_line));
    if (!options.quiet) print(fmt::format("tables  {}\n", (out / "tables.md").string()));
}

/// A line for each part that is not there, or lacks something.
void tell_missing(const std::vector<TableResult>& results) {
    for (const TableResult& result : results)
        if (!result.entry->missing.empty() || !result.lacks.empty()) note(fmt::format("{}: {}", result.entry->job.name, result.state));
}

void raise_missing(const std::vector<TableResult>& results) {
    std::size_t n_missing = 0, n_lacking = 0;
    for (const TableResult& result : results) {
        n_missing += !result.entry->missing.empty();
        n_lacking += !result.lacks.empty();
    }
    if (n_missing + n_lacking > 0)
        throw DataError(
            fmt::format("tables: {} of {} rows are missing, {} lack frames or labels, see above; the same command adds what has come",
                        n_missing, results.size(), n_lacking));
}

void run_tables(const TablesOptions& given, const std::string& command_line) {
    catch_interrupts();
    TablesOptions options = given;
    options.out = fs::absolute(options.out).lexically_normal().string();
    check_lpips(options);
    const std::vector<TableEntry> entries = plan_tables(options);
    const OutputFolder folder(options.out);
    BatchPlan plan{fs::path(options.out) / "parts.toml", options.out, {}};
    const std::vector<JobReport> reports = work_parts(plan, entries, options);
    const std::vector<TableResult> results = collect_results(entries, reports);
    if (!options.quiet && !reports.empty()) print("\n" + status_text(reports));
    write_tables(options.out, results, options, command_line);
    tell_missing(results);
    raise_ends(reports);
    raise_missing(results);
}

}  // namespace

void add_tables(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("tables", "the tables of the LiDAR-RT paper, made anew, beside what is printed");
    const auto options = std::make_shared<TablesOptions>();
    command->add_option("TABLES", options->tables, "paper: Tables 1 (Waymo Open) and 2 (KITTI-360)")
        ->required()
        ->check(CLI::IsMember({"paper"}));
    command->add_option("--kitti360", options->kitti360, "folder of KITTI-360, with data_3d_raw")->type_name("DIR");
    command->add_option("--waymo", options->waymo, "folder of Waymo Open's segments, *.tfrecord")->type_name("DIR");
    command->add_option("--out", options->out, "folder for all parts and the tables")->required()->type_name("DIR");
    command->add_option("--parts", options->parts, "some of ks1 to ks4, kd1 to kd6, ws1 to ws4, wd1 to wd4 (default: all of the datasets)")
        ->type_name("NAMES");
    command->add_option("--preset", options->presets, "settings of each row: paper (default), released, default, quick; several by commas")
        ->type_name("NAMES");
    add_set_option(*command, options->sets);
    command
        ->add_option("--lpips-weights", options->lpips, "weights of LPIPS (made by tools/lpips_weights); without them columns are empty")
        ->type_name("FILE");
    command->add_flag("--ablation", options->ablation, "the paper's ablations too, on the dynamic parts of KITTI-360 among the parts");
    command->add_flag("--retry-failed", options->retry_failed, "try again what failed before");
    add_device_options(*command, options->device);
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer(
        "DIR/ gets tables.md, table1_waymo.csv, table2_kitti360.csv, a folder for each part and preset (run, scans, batch.log), and "
        "parts.toml,\n"
        "with which `relidar batch DIR/parts.toml --out DIR` does the same work on many machines. The same command again goes on.\n"
        "A part that is not on disk, or fails, is a row that says so; the others go on, and the exit code is not 0.\n"
        "Examples:\n"
        "  relidar tables paper --kitti360 KITTI-360 --waymo waymo/training --out tables --lpips-weights lpips.safetensors\n"
        "  relidar tables paper --kitti360 KITTI-360 --out tables --parts kd1,kd2 --preset paper,default --set train.iterations=2000");
    command->callback([&call, options] { call.run = [&call, options] { run_tables(*options, call.command_line); }; });
}

}  // namespace relidar::cli
