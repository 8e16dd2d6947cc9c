// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "../../base/codecs/temporary_folder.hpp"
#include "example_run.hpp"

namespace relidar {

class SavedRun : public TemporaryFolder {
protected:
    void SetUp() override {
        TemporaryFolder::SetUp();
        run = make_example_run(folder / "run");
        save_run(run);
        scene = read_contents(run.folder / "scene.json");
    }

    relidar::Run run;
    std::string scene;  ///< text of scene.json
};

}  // namespace relidar
