// SPDX-License-Identifier: Apache-2.0
#include "command.hpp"

namespace relidar::cli {

void add_commands(CLI::App& app, ParsedCommand& call) {
    for (const auto& add : {add_demo, add_train, add_refine, add_render, add_view, add_serve, add_edit,
                            add_assets, add_eval, add_export, add_convert, add_info, add_list, add_check})
        add(app, call);
}

}  // namespace relidar::cli
