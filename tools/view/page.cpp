// SPDX-License-Identifier: Apache-2.0
#include "server.hpp"

#include <string>
#include <utility>

namespace relidar {

/// Names and contents of the files in page/. The build generates this function.
std::span<const std::pair<std::string_view, std::string_view>> view_page_texts();

namespace view {
namespace {

std::string_view content_type(std::string_view file) {
    if (file.ends_with(".js")) return "text/javascript; charset=utf-8";
    if (file.ends_with(".css")) return "text/css; charset=utf-8";
    return "text/html; charset=utf-8";
}

}  // namespace

const std::vector<WebPageFile>& web_page_files() {
    static const std::vector<WebPageFile> files = [] {
        std::vector<WebPageFile> all;
        for (const auto& [name, text] : view_page_texts())
            all.push_back({name == "index.html" ? "/" : "/" + std::string(name), content_type(name), text});
        return all;
    }();
    return files;
}

}  // namespace view
}  // namespace relidar
