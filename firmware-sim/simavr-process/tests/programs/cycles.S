; One section for each instruction, numbered as they come. A section counts from the
; end of one OUT to the end of the next, so each is one longer than what it names.
#define __SFR_OFFSET 0
#include <avr/io.h>

.macro begin number
	ldi r18, \number
	out GPIOR0, r18
.endm
.macro end
	out GPIOR0, r17
.endm

	.global main
main:
	clr r17
	ldi r26, 0
	ldi r27, 4
	movw r28, r26
	movw r30, r26
	begin 1
	add r20, r21
	end
	begin 2
	adiw r24, 1
	end
	begin 3
	mul r20, r21
	end
	begin 4
	fmulsu r20, r21
	end
	begin 5
	ld r20, X+
	end
	begin 6
	ldd r20, Y+3
	end
	begin 7
	ld r20, -Z
	end
	begin 8
	st X+, r20
	end
	begin 9
	std Y+3, r20
	end
	begin 10
	lds r20, 0x400
	end
	begin 11
	sts 0x400, r20
	end
	begin 12
	push r20
	end
	begin 13
	pop r20
	end
	begin 14
	in r20, GPIOR1
	end
	begin 15
	sbi EIMSK, 0
	end
	ldi r30, lo8(main)
	ldi r31, hi8(main)
	begin 16
	lpm r20, Z+
	end
	begin 17
	rjmp 1f
1:
	end
	begin 18
	jmp 1f
1:
	end
	begin 19
	call returns
	end
	begin 20
	rcall returns
	end
	ldi r30, lo8(gs(returns))
	ldi r31, hi8(gs(returns))
	begin 21
	icall
	end
	clz
	begin 22
	breq 1f
1:
	end
	sez
	begin 23
	breq 1f
1:
	end
	begin 24
	sbrc r17, 0
	nop
	end
	begin 25
	sbrc r17, 0
	jmp main
	end
	begin 26
	cpse r17, r17
	nop
	end
	begin 27
	muls r20, r21
	end
	begin 28
	sbis EIMSK, 7
	nop
	end
	begin 29
	wdr
	end
	begin 30
	movw r20, r22
	end
loop:
	rjmp loop
returns:
	ret
