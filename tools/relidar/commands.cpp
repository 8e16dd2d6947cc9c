// SPDX-License-Identifier: Apache-2.0
// Lists all commands in the order in which `relidar --help` shows them.
#include "command.hpp"

namespace relidar::cli {

void add_commands(CLI::App& app, ParsedCommand& selected_command) {
    for (const auto& add :
         {add_demo_command, add_train_command, add_refine_command, add_render_command, add_view_command,
          add_serve_command, add_edit_command, add_assets_command, add_eval_command, add_export_command,
          add_convert_command, add_info_command, add_list_command, add_check_command})
        add(app, selected_command);
}

}  // namespace relidar::cli
