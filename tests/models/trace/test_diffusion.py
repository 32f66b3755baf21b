import itertools

import pytest
import torch
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from diffusers.schedulers.scheduling_dpmsolver_multistep import DPMSolverMultistepScheduler

from footfall.models.trace.diffusion import DDIM, DDPM, CosineSchedule, DPMSolver2M, spaced_timesteps

K = 100
REFERENCE = {
    "num_train_timesteps": K,
    "beta_schedule": "squaredcos_cap_v2",
    "prediction_type": "sample",
}


@pytest.fixture
def schedule():
    return CosineSchedule(K)


def denoise(noisy, k):
    """Any deterministic function of the input will do as a model."""
    return torch.tanh(0.7 * noisy + 0.01 * k)


def run(solver, noisy):
    for i, k in enumerate(solver.timesteps):
        noisy = solver.step(denoise(noisy, k), noisy, i)
    return noisy


def test_schedule_equals_the_reference(schedule):
    reference = DDPMScheduler(**REFERENCE)
    assert torch.allclose(schedule.betas, reference.betas, atol=1e-6)
    assert torch.allclose(schedule.alphas_cumprod, reference.alphas_cumprod, atol=1e-6)


def test_noising_equals_the_reference(schedule):
    clean, noise = torch.randn(2, 5, 8, 2)
    k = torch.tensor([0, 10, 50, 98, 99])
    expected = DDPMScheduler(**REFERENCE).add_noise(clean, noise, k)  # pyright: ignore[reportArgumentType]
    assert torch.allclose(schedule.add_noise(clean, noise, k), expected, atol=1e-5)


def test_posterior_mean_equals_the_reference(schedule):
    reference = DDPMScheduler(**REFERENCE, clip_sample=False, variance_type="fixed_small")
    reference.set_timesteps(K)
    clean, noisy = torch.randn(2, 4, 3, dtype=torch.float64)
    for k in (99, 50, 1, 0):
        mean, variance = schedule.posterior(clean, noisy, k)
        generator = torch.Generator().manual_seed(3)
        drawn = reference.step(clean, k, noisy, generator=generator).prev_sample  # pyright: ignore
        noise = torch.randn(noisy.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
        expected = mean + (variance.sqrt() * noise if k else 0)
        assert torch.allclose(drawn, expected, atol=1e-5)


def test_ddpm_equals_the_reference(schedule):
    reference = DDPMScheduler(**REFERENCE, clip_sample=False)
    reference.set_timesteps(K)
    noisy = ours = torch.randn(4, 6)
    first, second = (torch.Generator().manual_seed(1) for _ in range(2))
    solver = DDPM(schedule)
    for i, k in enumerate(solver.timesteps):
        ours = solver.step(denoise(ours, k), ours, i, first)
        noisy = reference.step(denoise(noisy, k), k, noisy, generator=second).prev_sample  # pyright: ignore
    assert torch.allclose(ours, noisy, atol=1e-4)


@pytest.mark.parametrize("steps", [5, 10, 20])
def test_ddim_equals_the_reference(schedule, steps):
    reference = DDIMScheduler(**REFERENCE, clip_sample=False, timestep_spacing="trailing")
    reference.set_timesteps(steps)
    solver = DDIM(schedule, spaced_timesteps(K, steps))
    assert solver.timesteps == reference.timesteps.tolist()
    start = noisy = torch.randn(4, 6)
    for k in reference.timesteps:
        noisy = reference.step(denoise(noisy, k), k, noisy).prev_sample  # pyright: ignore
    assert torch.allclose(run(solver, start), noisy, atol=1e-4)


def test_noisy_ddim_equals_the_reference(schedule):
    reference = DDIMScheduler(**REFERENCE, clip_sample=False, timestep_spacing="trailing")
    reference.set_timesteps(10)
    first, second = (torch.Generator().manual_seed(1) for _ in range(2))
    solver = DDIM(schedule, spaced_timesteps(K, 10), eta=1.0)
    ours = noisy = torch.randn(4, 6)
    for i, k in enumerate(solver.timesteps[:-1]):
        ours = solver.step(denoise(ours, k), ours, i, first)
        noisy = reference.step(denoise(noisy, k), k, noisy, eta=1.0, generator=second).prev_sample  # pyright: ignore
        assert torch.allclose(ours, noisy, atol=1e-4)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # inside diffusers
@pytest.mark.parametrize(("steps", "power"), [(5, 1.0), (10, 1.0), (20, 1.0), (4, 1.35), (10, 2.0)])
def test_multistep_solver_equals_the_reference(schedule, steps, power):
    reference = DPMSolverMultistepScheduler(
        **REFERENCE, timestep_spacing="trailing", solver_order=2, final_sigmas_type="zero"
    )
    solver = DPMSolver2M(schedule, spaced_timesteps(K, steps, power))
    reference.set_timesteps(steps) if power == 1.0 else reference.set_timesteps(timesteps=solver.timesteps)
    assert solver.timesteps == reference.timesteps.tolist()
    start = noisy = torch.randn(4, 6)
    for k in reference.timesteps:
        noisy = reference.step(denoise(noisy, k), k, noisy).prev_sample  # pyright: ignore
    assert torch.allclose(run(solver, start), noisy, atol=2e-4)


def gaussian_clean(schedule, noisy, k, deviation):
    """The exact clean prediction when the data are normal with this deviation and mean 0."""
    a = schedule.alphas_cumprod[k]
    return a.sqrt() * deviation**2 / (a * deviation**2 + 1 - a) * noisy


@pytest.mark.parametrize(("kind", "steps"), [(DDPM, None), (DDIM, 50), (DPMSolver2M, 20)])
def test_solvers_draw_the_data_distribution(schedule, kind, steps):
    solver = kind(schedule, spaced_timesteps(K, steps)) if steps else kind(schedule)
    generator = torch.Generator().manual_seed(0)
    sample = torch.randn(20000, generator=generator)
    for i, k in enumerate(solver.timesteps):
        sample = solver.step(gaussian_clean(schedule, sample, k, 0.4), sample, i, generator)
    assert sample.std().item() == pytest.approx(0.4, rel=0.05)


def test_second_order_beats_first_order_on_few_steps(schedule):
    start = torch.randn(1000, generator=torch.Generator().manual_seed(0))

    def solve(solver):
        x = start
        for i, k in enumerate(solver.timesteps):
            x = solver.step(gaussian_clean(schedule, x, k, 0.4), x, i)
        return x

    exact = solve(DDIM(schedule, range(K - 1, -1, -1)))
    error = {
        s: (solve(s(schedule, spaced_timesteps(K, 12))) - exact).abs().mean() for s in (DDIM, DPMSolver2M)
    }
    assert error[DPMSolver2M] < 0.5 * error[DDIM]


def test_noise_and_clean_are_inverse(schedule):
    clean, noisy = torch.randn(2, 7)
    noise = schedule.noise_from_clean(clean, noisy, 40)
    assert torch.allclose(schedule.clean_from_noise(noise, noisy, 40), clean, atol=1e-5)


@pytest.mark.parametrize(("k", "j"), [(99, 90), (70, 28), (28, 5)])
def test_what_leads_from_one_step_to_another_is_found_again(schedule, k, j):
    clean, noisy = torch.randn(2, 7)
    later = DDIM(schedule, [k, j]).step(clean, noisy, 0)
    assert torch.allclose(schedule.clean_between(noisy, k, later, j), clean, atol=1e-4)


def test_classifier_free_weights(schedule):
    given, free, noisy = torch.randn(3, 7)
    assert torch.allclose(schedule.classifier_free(given, free, noisy, 30, 0.0), given, atol=1e-5)
    assert torch.allclose(schedule.classifier_free(given, free, noisy, 30, -1.0), free, atol=1e-5)
    # eq 4 is affine, so mixing noise is mixing clean predictions.
    assert torch.allclose(
        schedule.classifier_free(given, free, noisy, 30, 2.0), given + 2 * (given - free), atol=1e-4
    )


@pytest.mark.parametrize("power", [1.0, 1.35, 3.0])
@pytest.mark.parametrize("steps", [1, 4, 20, 100])
def test_steps_are_from_the_noisiest_down_and_all_different(steps, power):
    indices = spaced_timesteps(K, steps, power)
    assert len(indices) == steps and indices[0] == K - 1 and indices[-1] >= 0
    strides = [a - b for a, b in itertools.pairwise(indices)]
    assert all(stride >= 1 for stride in strides)
    assert power == 1.0 or steps != 4 or strides == sorted(strides)


@pytest.mark.parametrize("steps", [0, 101])
def test_too_few_or_many_steps_are_refused(steps):
    with pytest.raises(ValueError, match="1 to 100 steps"):
        spaced_timesteps(K, steps)


def test_empty_schedule_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        CosineSchedule(0)
