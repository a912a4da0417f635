//! The fast sampler.

use super::*;

#[test]
fn few_steps_come_close_to_many() {
    let fast = |steps| {
        let quality = Quality::Fast(Reuse::Never);
        let own = Sampler {
            quality,
            steps,
            ..Sampler::released(Variant::SuperResolution)
        };
        targets(&run(&own, &mut Unobserved).0)
    };
    let reference = fast(150);
    let [few, more] = [12, 36].map(|steps| largest_difference(&fast(steps), &reference));
    assert!(few < 0.05 && more < few / 3.0, "{few} {more}");
}

#[test]
fn fast_steps_use_a_draw_and_its_negative() {
    for (reuse, drawn, signs) in [
        (Reuse::Never, vec![0, 2, 4], [1.0, -1.0, 1.0, -1.0, 1.0]),
        (
            Reuse::EverySecond { split: 0 },
            vec![0, 4],
            [1.0, 1.0, -1.0, -1.0, 1.0],
        ),
    ] {
        let mut seen = Seen::default();
        let own = sampler(Quality::Fast(reuse), 5);
        let (_, draws) = run(&own, &mut seen);
        let warps = drawn.iter().map(|&step| Draw::Warp(step));
        assert_eq!(
            draws,
            [Draw::Latents].into_iter().chain(warps).collect::<Vec<_>>()
        );
        let schedule = released();
        for (step, timestep) in own.timesteps(&schedule).unwrap().into_iter().enumerate() {
            let last = drawn
                .iter()
                .copied()
                .filter(|&drawn| drawn <= step)
                .max()
                .unwrap();
            let noise = (waves((3, 4, 4, 4), Draw::Warp(last)) * signs[step]).unwrap();
            let input = targets(&seen.inputs[step].narrow(0, 0, 3).unwrap());
            let latents = input.narrow(3, 0, 4).unwrap();
            let projections = targets(&conditions().latents);
            let mix = schedule
                .warp_mix(&projections, &targets(&noise), &latents, timestep)
                .unwrap();
            let got = input.narrow(3, 4, 4).unwrap();
            assert!(largest_difference(&got, &mix) < 1e-6, "{reuse:?} {step}");
        }
    }
}
