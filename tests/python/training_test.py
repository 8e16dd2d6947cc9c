# SPDX-License-Identifier: Apache-2.0
"""Tests training and evaluation: callbacks, ways to stop and to resume, calls from several threads,
and scores that equal the scores of the command line tool."""
import json
import os
import signal
import threading
import unittest

import numpy as np

import relidar
from common import FOLDER, TestCase, config, log, run, street, tool


class Train(TestCase):
    def test_callback_sees_the_log(self):
        lines, notes = [], []
        trained = relidar.train(log(), config(), callback=lambda p: lines.append((p.iteration, p.loss, p.terms)), note=notes.append)
        self.assertEqual([line[0] for line in lines], [1, 5, 10, 15, 20, 25, 30])
        self.assertLess(lines[-1][1], 0.8 * lines[0][1])   # the loss must decrease
        for _, loss, terms in lines:
            self.assertAlmostEqual(sum(terms.values()), loss, places=6)
        self.assertTrue(notes)
        self.assertEqual(trained.folder, "")
        self.assertEqual(trained.held_out, [4])

    def test_false_ends_it(self):
        seen = []

        def callback(progress):
            seen.append(progress.iteration)
            return progress.iteration < 10

        stopped = relidar.train(log(), config(), callback=callback)
        self.assertLess(seen[-1], 30)
        self.assertGreater(len(stopped.scene), 100)

    def test_an_exception_of_the_callback_is_raised(self):
        def callback(progress):
            raise KeyError("mine")

        with self.assertRaisesRegex(KeyError, "mine"):
            relidar.train(log(), config(), callback=callback)

    def test_the_device_is_busy_for_the_callback(self):
        renders = lambda progress: run().render(time=0.0)  # noqa: E731
        self.assert_fails(relidar.UsageError, "busy", relidar.train, log(), config(), callback=renders)

    def test_ctrl_c_and_resume(self):
        checkpoints = FOLDER / "checkpoints"

        def interrupt(progress):
            if progress.iteration == 10:
                os.kill(os.getpid(), signal.SIGINT)

        with self.assertRaises(KeyboardInterrupt):
            relidar.train(log(), config(), callback=interrupt, checkpoints=checkpoints)
        lines = []
        resumed = relidar.train(log(), config(), callback=lambda p: lines.append(p.iteration), checkpoints=checkpoints, resume=True)
        self.assertGreater(lines[0], 10)
        self.assertEqual(lines[-1], 30)
        self.assertGreater(len(resumed.scene), 100)
        self.assert_fails(relidar.UsageError, "resume=True ... checkpoints", relidar.train, log(), config(), resume=True)
        other = config().copy()
        other["loss.depth"] = 0.9
        self.assert_fails(relidar.UsageError, "loss.depth", relidar.train, log(), other, checkpoints=checkpoints, resume=True)

    def test_ctrl_c_while_the_network_is_trained(self):
        checkpoints, settings = FOLDER / "network_checkpoints", config().copy()
        for key, value in {"train.checkpoint_minutes": 1e-9, "refine.network": "small", "refine.epochs": 8}.items():
            settings[key] = value
        in_network = threading.Event()

        def interrupt():
            while not in_network.wait(0.01):
                if list((checkpoints / "drop_network").glob("iteration_*")):
                    os.kill(os.getpid(), signal.SIGINT)
                    return

        watcher = threading.Thread(target=interrupt)
        watcher.start()
        try:
            with self.assertRaises(KeyboardInterrupt):
                relidar.train(log(), settings, checkpoints=checkpoints)
        finally:
            in_network.set()
            watcher.join()
        notes = []
        resumed = relidar.train(log(), settings, note=notes.append, checkpoints=checkpoints, resume=True)
        self.assertEqual([note for note in notes if "ray-drop network" in note], [])
        self.assertFalse((checkpoints / "drop_network").exists(), "a finished network has no checkpoint")
        resumed.save(FOLDER / "resumed")
        network = (FOLDER / "resumed" / "drop_network.safetensors").read_bytes()
        tool("refine", FOLDER / "resumed", "--no-eval")
        self.assertEqual((FOLDER / "resumed" / "drop_network.safetensors").read_bytes(), network, "trained in one go, it has the same bits")

    def test_other_threads_run_meanwhile(self):
        done, settings = threading.Event(), config().copy()
        settings["refine.enabled"] = False
        worker = threading.Thread(target=lambda: (relidar.train(log(), settings), done.set()))
        worker.start()
        turns = 0
        while not done.wait(0.01):
            turns += 1
        worker.join()
        self.assertGreater(turns, 10)

    def test_two_threads_share_a_device(self):
        expected = [run().render(time=t)["range"] for t in run().times[:4]]
        results = [None] * 4

        def render(k):
            results[k] = relidar.Run.load(run().folder).render(time=run().times[k])["range"]

        threads = [threading.Thread(target=render, args=(k,)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for actual, wanted in zip(results, expected):
            self.assert_same(actual, wanted)

    def test_bad_log(self):
        self.assert_fails(relidar.UsageError, "test_every", relidar.train, log(), relidar.Config("quick", {"dataset.test_every": 1}))
        self.assert_fails(relidar.UsageError, "frame 999", relidar.train, log(), relidar.Config("quick", {"dataset.test_frames": "1,999"}))


class Evaluate(TestCase):
    def test_is_what_the_tool_says_and_what_numpy_says(self):
        tool("eval", run().folder, "--out", FOLDER / "metrics.json")
        written = json.loads((FOLDER / "metrics.json").read_text())
        scores = relidar.evaluate(run())
        self.assertEqual(set(scores["mean"]), set(written["mean"]))
        for name, value in scores["mean"].items():
            self.assertAlmostEqual(value, written["mean"][name], delta=1e-4 * abs(value) + 1e-9, msg=name)

        position = run().held_out[0]
        rendered, real = run().render(time=run().times[position]), log().scan(position)
        both = (rendered["drop_prob"] < 0.5) & (rendered["range"] > 0) & (real["range"] > 0)
        errors = np.abs(rendered["range"].astype(float) - real["range"])[both]
        metrics = scores["frames"][0]["metrics"]
        self.assertAlmostEqual(metrics["strict/depth_mae_m"], errors.mean(), delta=1e-3 * errors.mean())
        self.assertAlmostEqual(metrics["strict/depth_rmse_m"], np.sqrt((errors**2).mean()), delta=1e-3 * np.sqrt((errors**2).mean()))
        self.assertEqual(scores["frames"][0]["frame"], run().frame_numbers[position])

    def test_baseline(self):
        told = []
        baseline = relidar.evaluate(run(), log(), baseline="nearest", progress=lambda what, done: told.append(done))
        self.assertIn("strict/depth_medae_m", baseline["mean"])
        self.assertEqual((told[0], told[-1]), (0.0, 1.0))

    def test_progress_may_end_it(self):
        def refuse(what, done):
            raise RuntimeError("enough")

        with self.assertRaisesRegex(RuntimeError, "enough"):
            relidar.evaluate(run(), log(), progress=refuse)
        self.assertTrue(relidar.evaluate(run(), log())["mean"])   # the device must be free again

    def test_bad_input(self):
        self.assert_fails(relidar.UsageError, "\"nerest\" ... nearest-actors", relidar.evaluate, run(), log(), baseline="nerest")
        part = relidar.load_log(street(), relidar.Config("quick", {"dataset.frames_end": 3}))
        self.assert_fails(relidar.DataError, "frame 4", relidar.evaluate, run(), part)


class Pictures(TestCase):
    def test_png(self):
        for scan in (run().render(time=run().times[0]), log().scan(0)):
            relidar.write_picture(FOLDER / "scan.png", scan)
            self.assertEqual((FOLDER / "scan.png").read_bytes()[:8], b"\x89PNG\r\n\x1a\n")
        self.assert_fails(relidar.DataError, '"range"', relidar.write_picture, FOLDER / "scan.png", {})


if __name__ == "__main__":
    unittest.main()
